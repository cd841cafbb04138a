"""Directions of a push, by name."""

from __future__ import annotations

import math
from collections.abc import Sequence

from benchmarks.harness import chosen

_NAMES = ("forward", "forward-left", "left", "back-left", "backward", "back-right", "right", "forward-right")


def direction_name(angle: float) -> str:
    """What a heading relative to the robot's [rad] is called: a word where there is one, degrees otherwise."""
    eighth = angle / (0.25 * math.pi)
    if abs(eighth - round(eighth)) < 1e-6:  # 1e-6: rounding
        return _NAMES[round(eighth) % len(_NAMES)]
    return f"{math.degrees(angle):.0f} deg"


def angles(bench: str, count: int, names: Sequence[str] = ()) -> list[float]:
    """Evenly spread headings [rad], the first forward, or those of them that are chosen.

    Args:
        bench: What is run, for the message.
        count: How many there are.
        names: The user's choice, as ``direction_name`` has them; all of them when empty.

    Raises:
        ConfigError: One is unknown; the known ones are listed.
    """
    known = {direction_name(angle): angle for angle in (2.0 * math.pi * k / count for k in range(count))}
    wanted = chosen(bench, names, list(known))
    return [angle for name, angle in known.items() if name in wanted]
