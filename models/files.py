"""Folder of files kept from run to run, and files that get their name once they are complete."""

import os
from pathlib import Path

from models.errors import ConfigError, PoiseError


def state_folder(name: str) -> Path:
    """Folder ``poise/<name>`` in the user's state folder, which is ``$XDG_STATE_HOME``, else ``~/.local/state``.

    Raises:
        ConfigError: There is neither that variable nor a home folder.
    """
    state = os.environ.get("XDG_STATE_HOME")
    try:
        return (Path(state) if state else Path.home() / ".local" / "state") / "poise" / name
    except RuntimeError as error:
        raise ConfigError(f"no folder for {name} files: neither XDG_STATE_HOME nor a home folder is set") from error


def part_beside(path: Path) -> Path:
    """Empty file beside ``path`` to write into until it is complete, and then to ``replace`` it.

    Raises:
        PoiseError: It cannot be written.
    """
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
