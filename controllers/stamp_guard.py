"""Stamps of a source that are refused, and the steps between those that are not."""

from __future__ import annotations

from controllers.leap import Leap
from models.errors import MessageError


class StampGuard:
    """Refuses a stamp that is not newer than the last one believed, or that leaps ahead alone.

    Args:
        largest: Largest step that is believed at once [ns].

    Attributes:
        last: The last stamp that was believed [ns]; None before the first.
    """

    def __init__(self, largest: int) -> None:
        self._leap = Leap(largest)
        self.last: int | None = None

    def step(self, stamp: int) -> int:
        """Take a stamp [ns]; returns the step since the last one [ns], 0 for the first.

        Raises:
            MessageError: It is not believed.
        """
        if self.last is None:
            self.last = stamp
            return 0
        if stamp <= self.last:
            raise MessageError(f"header.stamp: {stamp} ns is not after {self.last} ns")
        if not self._leap.believes(self.last, stamp):
            raise MessageError(f"header.stamp: {stamp} ns leaps ahead of {self.last} ns")
        step, self.last = stamp - self.last, stamp
        return step
