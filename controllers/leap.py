"""Stamps that leap ahead."""

from __future__ import annotations


class Leap:
    """Tells a wrong stamp from a gap: a large step ahead is believed when the next stamp goes on from it.

    Args:
        largest: Largest step that is believed at once, in the unit of the stamps.
    """

    def __init__(self, largest: float) -> None:
        self._largest = largest
        self._to: float | None = None

    def believes(self, last: float, stamp: float) -> bool:
        """Whether a stamp follows the last one that was believed; it is not before that one."""
        to, self._to = self._to, None
        if stamp - last <= self._largest or (to is not None and 0.0 < stamp - to <= self._largest):
            return True
        self._to = stamp
        return False
