"""Slip: a sole that keeps contradicting the prediction is no longer taken to stand still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.config import SlipConfig
from models.compiled import njit
from models.types import Matrix, Vector

Array = NDArray[np.float64]


@njit(cache=True)
def _watch(
    innovation: Array, stands: Array, gate: float, limits: Array, dt: float, timers: Array, slipping: Array,
    counts: Array, densities: Array,
) -> bool:  # fmt: skip
    """One step of ``SlipMonitor``; ``timers``: over the gate, quiet (2, 2) [s]; ``limits``: their ends, density."""
    changed = False
    for foot in range(2):
        if stands[foot] <= 0.0:  # in the air nothing is expected of it
            timers[foot, 0], timers[foot, 1], slipping[foot] = 0.0, 0.0, 0.0
            continue
        if innovation[foot] > gate:
            timers[foot, 0] += dt
            timers[foot, 1] = 0.0
        else:
            timers[foot, 0] = 0.0
            timers[foot, 1] += dt
        if slipping[foot] > 0.0:
            if timers[foot, 1] > limits[1]:
                slipping[foot] = 0.0
        elif timers[foot, 0] > limits[0]:
            slipping[foot] = 1.0
            counts[foot] += 1.0
            changed = True
        if slipping[foot] > 0.0:
            densities[foot, 0] = max(densities[foot, 0], limits[2])
    return changed


class SlipMonitor:
    """Slips of bearing feet, from the innovation of their kinematic measurement.

    A foot slips once its normalised innovation has been above the gate for ``time``. Its position then wanders with
    ``density`` until the innovation has stayed below the gate for ``recover_time``.

    Attributes:
        slipping: 1 where a foot slips, else 0 (2,).
        counts: Slips of each foot (2,).
        changed: Whether a slip began in the last step.

    Args:
        config: Limits.
        gate: Of the normalised innovation squared [-].
    """

    def __init__(self, config: SlipConfig, gate: float) -> None:
        self._gate = gate
        self._limits = np.array([config.time, config.recover_time, config.density])
        self.changed = False
        self._timers = np.zeros((2, 2))
        self.slipping, self.counts = np.zeros(2), np.zeros(2)

    def reset(self) -> None:
        """No foot has slipped."""
        self._timers[:], self.slipping[:], self.counts[:] = 0.0, 0.0, 0.0

    def update(self, innovation: Vector, stands: Vector, dt: float, densities: Matrix) -> None:
        """Take in the innovations of the last update.

        Args:
            innovation: Normalised innovation squared of each foot (2,) [-].
            stands: Confidence that each foot stands still (2,) [-].
            dt: Step [s].
            densities: In and out: random walk of position and orientation of each foot (2, 2) [m/sqrt(s), rad/sqrt(s)].
        """
        self.changed = _watch(
            innovation, stands, self._gate, self._limits, dt, self._timers, self.slipping, self.counts, densities,
        )  # fmt: skip
