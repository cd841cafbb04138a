"""numba's ``njit`` with a cache that a change of any kernel empties.

numba keys its cache by the file of the compiled function alone: a kernel that calls one in another file would go on
running the old machine code after the other file has changed. Here the cache lies in a folder named after a hash of
every kernel source of the project, in the user's cache folder, so a read-only installation works too.

Environment:
    NUMBA_CACHE_DIR: Parent of that folder, instead of ``$XDG_CACHE_HOME/poise/numba``.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

import numba
from numba import njit

__all__ = ["njit", "source_hash"]

_PACKAGES = ("models", "planners", "controllers", "bridge")
_MARK = b"from models.compiled import"


def source_hash(root: Path) -> str:
    """Hash over every source below ``root``'s packages that imports this module.

    Args:
        root: Folder that holds the packages.

    Returns:
        Sixteen hexadecimal digits.
    """
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for file in sorted((root / package).rglob("*.py")):
            source = file.read_bytes()
            if _MARK in source:
                digest.update(str(file.relative_to(root)).encode() + b"\0" + source)
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    parent = os.environ.get("NUMBA_CACHE_DIR") or Path(cache) / "poise" / "numba"
    return Path(parent) / source_hash(Path(__file__).resolve().parents[1])


try:
    _cache_folder().mkdir(parents=True, exist_ok=True)
    vars(numba.config)["CACHE_DIR"] = str(_cache_folder())
except OSError:  # no home that can be written: kernels are compiled anew in every process
    vars(numba.config)["CACHE_DIR"] = str(Path(tempfile.mkdtemp(prefix="poise-numba-")))
