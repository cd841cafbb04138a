"""A robot that is lifted off the floor while it walks: its gait freezes until it is put down."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from models.robot_model import RobotModel
from models.spline import min_jerk
from models.types import Reference, RobotState, Vector
from planners.gait.config import LiftConfig
from planners.gait.footsteps import Foothold
from planners.gait.reference import yaw_matrix


class Lifted:
    """Notices that neither foot bears load, and holds the posture of that moment.

    A leg that is to carry the robot meets no resistance in the air: within 20 ms its hip was seen to turn at 10 rad/s.
    So the robot is held after ``float_time``, before it is known whether it has been lifted; should a foot bear load
    before ``up_time``, its gait goes on. Once lifted, it slowly returns to the standing posture, in which it can be put
    down: with one foot ahead of the other and higher, its weight would come to lie beside them.

    Args:
        model: The robot.
        config: Times.

    Attributes:
        active: Whether no foot bears load, so that the robot is to be held as it was.
        confirmed: Whether that has lasted for so long that the walk is over.
    """

    def __init__(self, model: RobotModel, config: LiftConfig) -> None:
        self._model, self._config = model, config
        self._zero, self._none, self._still = np.zeros(model.nj), np.zeros(3), np.zeros((2, 6))
        self._stand = self._posture = model.posture("stand")
        self._since = 0.0
        self.reset()

    def reset(self) -> None:
        """The robot stands."""
        self.active = self.confirmed = False
        self._time = 0.0

    def update(self, bearing: tuple[bool, bool], state: RobotState, dt: float) -> bool:
        """Look at the feet.

        Args:
            bearing: Whether each foot bears load.
            state: Estimated state.
            dt: Time since the last look [s].

        Returns:
            Whether the robot has just been put down.
        """
        config = self._config
        counts = all(bearing) if self.confirmed else not any(bearing)
        self._time = self._time + dt if counts else 0.0
        self._since += dt
        if self.confirmed:
            return self._time >= config.down_time
        if not counts:
            self.active = False
        elif not self.active and self._time >= config.float_time:
            self.active = True
            self._posture = np.clip(state.q[7:], self._model.q_lower, self._model.q_upper)
        elif self._time >= config.up_time:
            self.confirmed, self._time, self._since = True, 0.0, 0.0
        return False

    def reference(self, state: RobotState, com: Vector, footholds: Sequence[Foothold]) -> Reference:
        """What a robot in the air is to track: the posture of then, or on the way to standing, without any contact.

        Args:
            state: Estimated state.
            com: Measured CoM in W (3,) [m].
            footholds: Where the soles are measured.
        """
        posture, rate = self._posture, self._zero
        if self.confirmed:
            u = min(self._since / self._config.level_time, 1.0)
            way = self._stand - posture
            share, growth, _ = min_jerk(u)
            posture = posture + share * way
            rate = growth / self._config.level_time * way
        upright = pin.Quaternion(state.q[3:7]).toRotationMatrix()
        return Reference(
            com=com.copy(),
            com_velocity=self._none,
            com_acceleration=self._none,
            base_orientation=upright,
            torso_orientation=upright,
            posture=posture,
            posture_velocity=rate,
            posture_acceleration=self._zero,
            sole_rotations=np.array([yaw_matrix(hold.yaw) for hold in footholds]),
            sole_positions=np.array([(hold.x, hold.y, hold.z) for hold in footholds]),
            sole_velocities=self._still,
            sole_accelerations=self._still,
            contacts=(False, False),
            dcm=com[:2].copy(),
            dcm_velocity=self._none[:2],
        )
