"""Start of a held robot: gravity compensation, and the release once its feet bear its weight."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from bridge.plants.base import SimulatedPlant
from bridge.plants.config import LoopConfig
from models.constants import GRAVITY
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import JointCommand


def hanging_command(model: RobotModel) -> JointCommand:
    """Set-point that holds the 'stand' posture with a fixed base and no load on the feet: tau = g(q)."""
    q = model.standing_configuration("stand")
    gravity = pin.computeGeneralizedGravity(model.pin, model.data(), q)  # (nv,)
    return JointCommand(q=q[7:].copy(), v=np.zeros(model.nj), tau=gravity[6:].copy())


class ReleaseGate:
    """Detects that the feet of a held robot bear its weight, so that a release changes nothing.

    Open when |F_z - m g| <= load_tolerance m g for the vertical load on both soles, averaged over ``load_window``, and
    at least ``settle_time`` has passed. The load is the true one, as a crane measures it.

    Attributes:
        load: Last averaged load on both feet [N].
        weight: Weight of the robot's model [N].
        waited: Time since the start [s].
    """

    def __init__(self, model: RobotModel, config: LoopConfig) -> None:
        self.weight = GRAVITY * model.mass
        self.load = 0.0
        self.waited = 0.0
        self._config = config
        self._sum, self._window = 0.0, 0.0

    def update(self, load: float, dt: float) -> bool:
        """Add a load [N], ``dt`` [s] after the last; returns whether the robot may be released."""
        self.waited += dt
        self._window += dt
        self._sum += dt * load
        if self._window < self._config.load_window:
            return False
        self.load = self._sum / self._window
        self._sum = self._window = 0.0
        loaded = abs(self.load - self.weight) <= self._config.load_tolerance * self.weight
        return loaded and self.waited >= self._config.settle_time


def release_loaded(
    robot: RobotModel,
    plant: SimulatedPlant,
    config: LoopConfig,
    step: Callable[[], None],
    fault: Callable[[], str] = lambda: "",
) -> None:
    """Step a held robot until its feet bear its weight, and release it.

    ``step`` runs one tick; ``fault`` returns why the robot cannot stand, empty while it can. Raises ``PoiseError`` when
    the feet do not take the weight within ``settle_limit``, or on a fault.
    """
    gate = ReleaseGate(robot, config)
    while not gate.update(plant.load, plant.period):
        why = fault()
        if why or gate.waited > config.settle_limit:
            why = why or f"the feet carry {gate.load:.0f} N of {gate.weight:.0f} N"
            raise PoiseError(f"{robot.name} cannot be let go after {gate.waited:.1f} s: {why}")
        step()
    plant.release()
