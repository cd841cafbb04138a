"""Folders of persistent files, and files that are renamed to their final name once complete."""

import os
from pathlib import Path
from zipfile import is_zipfile

import numpy as np
from numpy.lib.npyio import NpzFile

from models.errors import ConfigError, PoiseError


def user_folder(name: str, variable: str, usual: str) -> Path:
    """``poise/<name>`` in the folder of an XDG ``variable``, else in ``~/<usual>``; ``ConfigError`` without a home."""
    given = os.environ.get(variable)
    try:
        return (Path(given) if given else Path.home() / usual) / "poise" / name
    except RuntimeError as error:
        raise ConfigError(f"no folder for {name} files: neither {variable} nor a home folder is set") from error


def state_folder(name: str) -> Path:
    """``poise/<name>`` in ``$XDG_STATE_HOME``, else in ``~/.local/state``: state that programs keep between runs."""
    return user_folder(name, "XDG_STATE_HOME", ".local/state")


def open_arrays(path: Path) -> NpzFile:
    """Open an archive of ``np.savez``; ``OSError`` if unreadable, ``ValueError`` if incomplete or not an archive."""
    with path.open("rb") as file:
        if not is_zipfile(file):  # for such a file NumPy's error suggests unpickling
            raise ValueError("no NumPy archive, or an incomplete one")
    archive: NpzFile = np.load(path, allow_pickle=False)
    return archive


def part_beside(path: Path) -> Path:
    """Create an empty file beside ``path``, to be written and renamed to it; ``PoiseError`` if that is impossible."""
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.touch()
    except OSError as error:
        raise PoiseError(f"{path} cannot be written: {error}") from error
    if path.is_dir():
        part.unlink()
        raise PoiseError(f"{path} cannot be written: it is a folder")
    return part
