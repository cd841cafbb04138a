"""Files that have their name only once they are complete."""

from __future__ import annotations

from pathlib import Path

from models.errors import PoiseError


def part_beside(path: Path) -> Path:
    """Empty file beside ``path`` to write into until it is complete; ``replace`` gives it its name.

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
