"""Where files go that a robot's processes keep from run to run."""

from __future__ import annotations

import os
from pathlib import Path

from models.errors import ConfigError


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
