"""numba's ``njit`` with a cache keyed by content: a kernel is recompiled when it or a kernel that it calls changes.

numba's default cache depends only on path and modification time of the kernel's file. A kernel that calls one in
another file would keep stale machine code after a change of that file, and every checkout would recompile. Here each
source file has a cache folder named after a hash of the file and of every kernel source that it imports.

Functions that take records are inlined into their kernel (``forceinline``): a call would copy every field of a record,
used or not, and these instructions would fill the instruction cache.

Environment:
    NUMBA_CACHE_DIR: Parent of these folders; default ``$XDG_CACHE_HOME/poise/numba``.
    NUMBA_OPT: LLVM's optimisation level; default 2.
"""

from __future__ import annotations

import ast
import atexit
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import numba
from numba import njit
from numba.core import caching
from numba.extending import register_jitable as _register_jitable

__all__ = ["KernelCacheLocator", "njit", "register_jitable", "source_hash"]

ROOT = Path(__file__).resolve().parents[2]
_PACKAGES = ("models", "planners", "controllers", "bridge")
_FALLBACK_LOCATORS = ("UserProvidedCacheLocator", "InTreeCacheLocator", "UserWideCacheLocator", "ZipCacheLocator")

F = TypeVar("F", bound=Callable[..., Any])


def register_jitable(function: F) -> F:
    """Make a plain Python function callable from kernels; it is compiled only as a part of them."""
    registered: F = _register_jitable(function)
    return registered


@cache
def _records(source: Path) -> frozenset[str]:
    """Names of the NamedTuples of a module; kernels access their fields by position."""
    classes = [node for node in ast.walk(ast.parse(source.read_bytes())) if isinstance(node, ast.ClassDef)]
    return frozenset(node.name for node in classes if any(ast.unparse(base) == "NamedTuple" for base in node.bases))


@cache
def _dependencies(file: Path, root: Path) -> tuple[Path, ...]:
    """Project sources from which a kernel source imports compiled functions, records or constants."""
    found = []
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in _PACKAGES:
            source = root / (node.module.replace(".", "/") + ".py")
            if not source.is_file():
                continue
            compiled = b"from models.numerics.compiled import" in source.read_bytes()
            if compiled or any(alias.name.isupper() or alias.name in _records(source) for alias in node.names):
                found.append(source)
    return tuple(found)


def source_hash(file: Path, root: Path = ROOT) -> str:
    """Hash, 16 hexadecimal digits, of a kernel source and of all sources of kernels and constants that it imports."""
    sources, todo = {file}, [file]
    while todo:
        new = set(_dependencies(todo.pop(), root)) - sources
        sources |= new
        todo += new
    digest = hashlib.sha256(numba.__version__.encode())
    for source in sorted(sources):
        digest.update(str(source.relative_to(root)).encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:16]


@cache
def _cache_folder() -> Path:
    """Parent of the cache folders; a temporary one, deleted at exit, if the user's is not writable."""
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(home) / "poise" / "numba")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        own, process = tempfile.mkdtemp(prefix="poise-numba-"), os.getpid()

        def remove() -> None:
            if os.getpid() == process:  # a forked process leaves the folder to its parent
                shutil.rmtree(own, ignore_errors=True)

        atexit.register(remove)
        return Path(own)
    return folder


class _Index(caching.IndexDataCacheFile):
    """Index of a kernel's machine code; an index with types of another project version counts as empty.

    With numba's numbering, two processes that compile a kernel for different types at the same time choose the same
    file name, and one loads the machine code of the other. Here every file of machine code has a unique name. Of two
    indexes written at the same time, the later one persists.
    """

    def _data_name(self, number: int) -> str:
        name: str = super()._data_name(uuid4().int)
        return name

    def _load_index(self) -> dict[Any, Any]:
        try:
            overloads: dict[Any, Any] = super()._load_index()
        except (AttributeError, ImportError):
            return {}
        return overloads


class KernelCacheLocator(caching._CacheLocator):
    """Location of the machine code of a kernel of this project."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        self._line = function.__code__.co_firstlineno
        self._hash = source_hash(Path(file).resolve())
        self._stem = Path(file).stem

    def get_cache_path(self) -> str:
        """Cache folder of the kernel's source."""
        return str(_cache_folder() / f"{self._stem}-{self._hash}")

    def get_source_stamp(self) -> str:
        """Hash of the sources, in place of a modification time."""
        return self._hash

    def get_disambiguator(self) -> str:
        """First line of the kernel."""
        return str(self._line)

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> KernelCacheLocator | None:
        """Locator of a function; None outside this project."""
        path = Path(file).resolve()
        inside = path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in _PACKAGES
        if not inside:
            return None
        locator = cls(function, file)
        Path(locator.get_cache_path()).mkdir(parents=True, exist_ok=True)
        return locator


if "NUMBA_OPT" not in os.environ:  # compiles in two thirds of the time of numba's default 3, with equal tick times
    vars(numba.config)["OPT"] = type(vars(numba.config)["OPT"])(2)
vars(caching)["IndexDataCacheFile"] = _Index
vars(numba.config)["CACHE_LOCATOR_CLASSES"] = ",".join(
    [f"{__name__}.{KernelCacheLocator.__name__}", *_FALLBACK_LOCATORS]
)
