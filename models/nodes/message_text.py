"""Text of message definitions as logs carry it, from the installed packages."""

from __future__ import annotations

import os
import sysconfig
from functools import cache
from pathlib import Path

from models.errors import MessageError

_RULE = 80 * "="


def message_text(name: str, *, header: bool = False) -> str:
    """Definition of a message, followed by those of all messages it consists of (the format ``ros2msg`` of MCAP).

    Args:
        name: For example ``sensor_msgs/msg/Imu``.
        header: Whether the message's own text gets a header too, to be put behind another one's.

    Raises:
        MessageError: A package or its text is not installed.
    """
    own, *others = _closure(name)
    parts = [_headed(other) for other in others]
    return "".join([_headed(own) if header else _text(own), *parts])


def _headed(name: str) -> str:
    return f"\n{_RULE}\nMSG: {name.replace('/msg/', '/')}\n{_text(name)}"


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
