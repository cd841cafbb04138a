"""Text of message definitions for logs, from the installed packages."""

import os
import sysconfig
from functools import cache
from pathlib import Path

from models.errors import MessageError

_RULE = 80 * "="


def message_text(name: str) -> str:
    """Definition of a message and of all messages in it (MCAP's ``ros2msg``); ``MessageError`` when not installed."""
    own, *others = _closure(name)
    parts = [f"\n{_RULE}\nMSG: {other.replace('/msg/', '/')}\n{_text(other)}" for other in others]
    return "".join([_text(own), *parts])


@cache
def _text(name: str) -> str:
    sourced = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    for prefix in (*sourced, sysconfig.get_path("data")):  # the wheels' share folder is that of the environment
        path = Path(prefix) / "share" / f"{name}.msg"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise MessageError(f"{name}: its definition is not installed")


def _closure(name: str) -> list[str]:
    """The message and every message in it, each once."""
    found = [name]
    for each in found:
        package = each.partition("/")[0]
        for line in _text(each).splitlines():
            words = line.partition("#")[0].split()
            kind = words[0].partition("[")[0] if words else ""
            if not kind[:1].isupper() and "/" not in kind:
                continue  # a primitive type
            where, _, short = kind.rpartition("/")
            full = f"{where.removesuffix('/msg') or package}/msg/{short}"
            if full not in found:
                found.append(full)
    return found
