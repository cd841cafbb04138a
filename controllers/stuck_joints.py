"""Arms and head that friction holds short of their posture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.upper_body import free_joints
from controllers.whole_body_config import StuckConfig
from models.compiled import njit
from models.robot_model import RobotModel
from models.types import Vector


class StuckJoints:
    r"""Integral of the posture error of joints that hardly move.

    .. math::
        \dot a_j = k_i (q_{ref} - q)_j \quad\text{where}\quad |\dot q_j| < v_{max},\ e_{min} < |q_{ref} - q|_j < e_{max}

    with the size of a_j at most ``most``; a joint that moves forgets it within ``fade_s``. The posture task is soft, so
    that arms give way and help to balance: friction of 0.05 N.m then holds a light forearm 5 deg off. Nothing adds up
    within the least error, so that no joint hunts, nor while a push moves the arms.

    Args:
        model: The robot.
        config: Gain and bounds.

    Attributes:
        acceleration: On top of that of the reference (nj,) [rad/s^2].
    """

    def __init__(self, model: RobotModel, config: StuckConfig) -> None:
        self._free = free_joints(model)
        self._bounds = np.array(
            [config.gain, config.most, config.error_least, config.error_most, config.speed, config.fade_s]
        )
        self.acceleration: Vector = np.zeros(model.nj)

    def reset(self) -> None:
        """Forget everything."""
        self.acceleration = np.zeros_like(self.acceleration)

    def step(self, posture: Vector, q: Vector, v: Vector, dt: float) -> Vector:
        """A tick of so many seconds later.

        Args:
            posture: Reference of the joints (nj,) [rad].
            q: Measured joints (nj,) [rad].
            v: Their velocities (nj,) [rad/s].
            dt: Since the last tick [s].

        Returns:
            ``acceleration``, a new array.
        """
        self.acceleration = self.acceleration.copy()
        _accumulate(self.acceleration, self._free, posture, q, v, self._bounds, dt)
        return self.acceleration


@njit(
    "void(float64[::1], boolean[::1], float64[::1], float64[::1], float64[::1], float64[::1], float64)",
    cache=True,
)
def _accumulate(
    total: Vector, free: NDArray[np.bool_], posture: Vector, q: Vector, v: Vector, bounds: Vector, dt: float
) -> None:
    """One step of the integral, in place; ``bounds`` are those of the configuration in its order (6,)."""
    gain, most, least, largest, speed, fade = bounds
    for j in range(total.shape[0]):
        if not free[j]:
            continue
        error = posture[j] - q[j]
        if abs(v[j]) >= speed or abs(error) >= largest:
            total[j] *= max(1.0 - dt / fade, 0.0)
        elif abs(error) > least:
            total[j] = min(max(total[j] + gain * error * dt, -most), most)
