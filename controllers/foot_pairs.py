"""Puts the samples of two foot sensors that arrive one by one together."""

from __future__ import annotations

import numpy as np

from controllers.stamp_guard import StampGuard
from models.constants import NANOSECONDS
from models.types import FOOT_NAMES, Vector


class FootPairs:
    """A pair is complete when both feet have given a newer sample, or the other one is silent for too long.

    Args:
        max_age: Age of one foot's sample against the other's above which it counts as silent [ns].
        max_gap: Largest step of a stamp that is believed at once [ns].

    Attributes:
        wrenches: Newest sample of each foot, in its sole frame (2, 6) [N, N.m]; zeros before the first.
        silent: Whether each foot's newest sample is too old (2,).
        stamp: Of the last pair [ns].
    """

    def __init__(self, max_age: int, max_gap: int) -> None:
        self.wrenches = np.zeros((len(FOOT_NAMES), 6))
        self.silent = [True] * len(FOOT_NAMES)
        self.stamp = 0
        self._max_age = max_age
        self._guards = [StampGuard(max_gap) for _ in FOOT_NAMES]
        self._begun: int | None = None

    def add(self, foot: int, stamp: int, wrench: Vector) -> float | None:
        """Take a sample.

        Args:
            foot: Index into ``FOOT_NAMES``.
            stamp: [ns].
            wrench: Ground reaction (6,) [N, N.m].

        Returns:
            Time since the last pair [s], 0 for the first; None while the other foot is waited for.

        Raises:
            MessageError: The stamp is not newer than this foot's last, or leaps ahead alone.
        """
        self._guards[foot].step(stamp)
        self.wrenches[foot] = wrench
        other = self._guards[1 - foot].last
        begun = stamp if self._begun is None else self._begun
        self._begun = begun
        late = stamp - (begun if other is None else other) > self._max_age
        if not late and (other is None or other <= self.stamp):
            return None
        self.silent[foot], self.silent[1 - foot] = False, late
        newest = stamp if other is None else max(stamp, other)
        dt = 0.0 if self.stamp == 0 else (newest - self.stamp) / NANOSECONDS
        self.stamp = newest
        return dt
