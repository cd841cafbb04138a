"""Ways to spoil a message. Each takes the message and the stamp of the first spoilt one [ns]; None: it is not sent."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import Any

from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import set_stamp, stamp_ns

SHIFT = NANOSECONDS
"""How far an old or future stamp is off [ns]."""

TICK = NANOSECONDS // 1000
"""Between two messages of a sensor [ns]."""

HOUR = 3600 * NANOSECONDS
"""How far ``/clock`` jumps [ns]."""

Spoil = Callable[[Any, int], Any]


def stamp_field(message: Any) -> Any:
    """Where a message has its time."""
    return message.clock if hasattr(message, "clock") else message.header.stamp


def _stamped(change: Callable[[int, int], int]) -> Spoil:
    """Another stamp, from that of now and that of the first spoilt message [ns]."""

    def spoil(message: Any, began: int) -> Any:
        field = stamp_field(message)
        set_stamp(field, max(change(stamp_ns(field), began), 0))
        return message

    return spoil


def _joints(change: Callable[[list[Any]], list[Any]], name: Callable[[list[str]], list[str]]) -> Spoil:
    """Other joints: their names, and their numbers in the same order."""

    def spoil(message: Any, began: int) -> Any:
        message.name = name(list(message.name))
        for field in ("position", "velocity", "effort"):
            setattr(message, field, array("d", change(list(getattr(message, field)))))
        return message

    return spoil


def _unnormalised(message: Any, began: int) -> Any:
    orientation = message.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = 0.5, 0.5, 0.5, 2.0
    return message


SPOILS: dict[str, Spoil] = {
    "silent": lambda message, began: None,
    "repeated": _stamped(lambda now, began: began),
    "backward": _stamped(lambda now, began: 2 * began - now),
    "old": _stamped(lambda now, began: now - SHIFT),
    "future": _stamped(lambda now, began: now + SHIFT),
    "leaping": _stamped(lambda now, began: now + SHIFT * ((now - began) // TICK % 2)),
    "hour_back": _stamped(lambda now, began: now - HOUR),
    "hour_ahead": _stamped(lambda now, began: now + HOUR),
    "reordered": _joints(lambda values: values[::-1], lambda names: names[::-1]),
    "missing": _joints(lambda values: values[:-1], lambda names: names[:-1]),
    "extra": _joints(lambda values: [*values, 0.0], lambda names: [*names, "tail_joint"]),
    "duplicate": _joints(lambda values: values, lambda names: [*names[:-1], names[0]]),
    "unnormalised": _unnormalised,
}
"""By the name that ``/spoil`` gives them."""
