"""How far the drivers' torques jump from tick to tick, beside what their rate limit lets them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np

from bridge.closed_loop import ClosedLoop
from models.types import Vector

ROUNDING = 1e-9
"""Of a step that is as large as the drivers' limit lets it be [-]."""


class TorqueSteps:
    """Watches what is written to the plant, before a motor that is at fault makes something else of it.

    Args:
        loop: The robot.

    Attributes:
        largest: Largest step of a joint's torque in one tick so far, in parts of its rate limit; inf for one to a
            torque that is no number [-].
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self.largest = 0.0
        self._loop = loop
        self._before: Vector | None = None

    def forget(self) -> None:
        """The next torques follow no earlier ones: the robot starts over."""
        self._before = None

    def within(self, limit: float) -> bool:
        """Whether no step was larger than a limit [-]."""
        return self.largest <= limit * (1.0 + ROUNDING)

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Look at every tick meanwhile."""
        plant = self._loop.plant
        write, scale = plant.write, self._loop.robot.tau_rate_max * plant.period

        def watched(tau: Vector) -> None:
            if self._before is not None:
                step = float((np.abs(tau - self._before) / scale).max())
                self.largest = max(self.largest, np.inf if np.isnan(step) else step)
            self._before = tau.copy()
            write(tau)

        with patch.object(plant, "write", watched):
            yield
