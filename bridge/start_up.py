"""How a held robot comes to stand: gravity compensation, averaged sensors, and the moment the weld lets go."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from bridge.loop_config import LoopConfig
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import JointCommand


def hanging_command(model: RobotModel) -> JointCommand:
    """Set-point that keeps a robot whose base is held in its 'stand' posture: tau = g(q), the feet carrying nothing."""
    q = model.standing_configuration("stand")
    gravity = pin.computeGeneralizedGravity(model.pin, model.data(), q)  # (nv,)
    return JointCommand(q=q[7:].copy(), v=np.zeros(model.nj), tau=gravity[6:].copy())


class ReleaseGate:
    """Says when the feet of a held robot carry it, so that letting go changes nothing.

    Open when |F_z - m g| <= load_tolerance m g for the vertical load on both soles, averaged over ``load_window``, and
    at least ``settle_time`` has passed. The load is the true one: a crane knows what it carries, and what the robot's
    own foot sensors make of it is for the robot to deal with.

    Args:
        model: Robot.
        config: Times and tolerance.

    Attributes:
        load: Last averaged load on both feet [N].
        weight: Weight of the robot as the model has it [N].
        waited: Time since the start [s].
    """

    def __init__(self, model: RobotModel, config: LoopConfig) -> None:
        self.weight = GRAVITY * model.mass
        self.load = 0.0
        self.waited = 0.0
        self._config = config
        self._sum, self._window = 0.0, 0.0

    def update(self, load: float, dt: float) -> bool:
        """Take one load [N], ``dt`` [s] after the last; returns whether the robot may be let go."""
        self.waited += dt
        self._window += dt
        self._sum += dt * load
        if self._window < self._config.load_window:
            return False
        self.load = self._sum / self._window
        self._sum = self._window = 0.0
        loaded = abs(self.load - self.weight) <= self._config.load_tolerance * self.weight
        return loaded and self.waited >= self._config.settle_time
