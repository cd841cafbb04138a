"""Head angles at the time of a picture."""

from collections import deque

import numpy as np

from models.types import Vector


class AngleHistory:
    """Keeps the newest ``size`` stamped angles and interpolates between them."""

    def __init__(self, size: int = 100) -> None:
        self._samples: deque[tuple[int, float, float]] = deque(maxlen=size)

    def add(self, stamp: int, pan: float, tilt: float) -> None:
        """Store pan and tilt [rad] at a stamp [ns]; a stamp older than the newest clears the history."""
        if self._samples and stamp <= self._samples[-1][0]:
            self._samples.clear()
        self._samples.append((stamp, pan, tilt))

    def at(self, stamp: int, tolerance: int) -> Vector | None:
        """Pan and tilt (2,) [rad] at a stamp [ns]; None where no sample is within a tolerance [ns] of it."""
        if not self._samples:
            return None
        stamps = [sample[0] for sample in self._samples]
        if not stamps[0] - tolerance <= stamp <= stamps[-1] + tolerance:
            return None
        since = [float(each - stamps[0]) for each in stamps]
        angles = [np.interp(float(stamp - stamps[0]), since, column) for column in zip(*self._samples, strict=True)]
        return np.array(angles[1:])
