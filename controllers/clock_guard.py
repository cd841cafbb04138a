"""Which times of the plant's clock are believed."""

from __future__ import annotations

from controllers.leap import Leap
from models.errors import MessageError


class ClockGuard:
    """Refuses times of a clock that cannot be: one that leaps ahead alone, and any step back while the robot moves.

    Ages, and how long a command holds, are counted on this clock. Were it set ahead for a moment, the velocity of a
    commander who then falls silent would hold for just as long. A leap that the next time goes on from is believed:
    then messages had been missing. A clock that has gone back is not believed before the robot is at rest; who needs
    it hears none until then, and damps.

    Args:
        leap_max: Largest step ahead that is believed at once [ns].
    """

    def __init__(self, leap_max: int) -> None:
        self._leap = Leap(leap_max)
        self._last: int | None = None

    def judge(self, stamp: int, *, moving: bool) -> None:
        """Take a time [ns]. One of a robot that does not move is believed whatever it is: its plant may be a new one.

        Raises:
            MessageError: It is not believed.
        """
        if moving and self._last is not None:
            if stamp < self._last:
                raise MessageError(f"clock: {stamp} ns is before {self._last} ns")
            if not self._leap.believes(self._last, stamp):
                raise MessageError(f"clock: {stamp} ns leaps ahead of {self._last} ns")
        self._last = stamp
