"""What else people run in a loop on a humanoid: the inverse kinematics of pink and mink, where they are installed.

They solve less than the tick does, and other than it: velocities, not accelerations; no dynamics, contact wrenches,
friction, torques or their limits. What they share: model, state, both soles held, CoM, torso orientation, posture, and
the limits of joint positions (pink: of velocities too). Their times say what kinematics alone costs from Python, and
are no measure of which is the better controller. TSID solves the tick's own problem, but no wheel of it installs beside
the Pinocchio that placo needs; see docs/peers.md.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np

from models.mujoco_model import build_mujoco, pin_to_mujoco
from models.robot_model import RobotModel
from models.types import RobotState

COSTS = {"sole": 10.0, "com": 5.0, "torso": 1.0, "posture": 1e-2}
"""Weights of the tasks, the same in both; they decide nothing about the time [-]."""

SOLVER = "daqp"
"""Back-end of both: the fastest dense one of this size."""

PERIOD = 0.001
"""Over which velocities are integrated [s]."""


class KinematicPeer(Protocol):
    """Inverse kinematics of one tick."""

    def prepare(self, state: RobotState) -> None:
        """Copy the state; not part of its tick."""
        ...

    def step(self) -> None:
        """One whole tick: kinematics, problem, solution."""
        ...


def installed_peers(model: RobotModel) -> dict[str, KinematicPeer]:
    """Those that can be imported here, by name."""
    kinds: dict[str, type[PinkTick] | type[MinkTick]] = {"pink": PinkTick, "mink": MinkTick}
    ready = find_spec("qpsolvers") is not None
    return {name: kind(model) for name, kind in kinds.items() if ready and find_spec(name) is not None}


class PinkTick:
    """pink's ``solve_ik`` on soles, CoM, torso and posture.

    Args:
        model: The robot.

    Attributes:
        velocity: Last answer (nv,) [m/s, rad/s].
    """

    def __init__(self, model: RobotModel) -> None:
        import pink
        from pink.tasks import ComTask, FrameTask, PostureTask

        self._solve = pink.solve_ik
        q = model.standing_configuration()
        self._configuration = pink.Configuration(model.pin, model.data(), q)
        names = [model.pin.frames[foot.frame_id].name for foot in model.feet]
        torso = model.pin.frames[model.frame_id("torso")].name
        self._tasks: list[Any] = [
            *(FrameTask(name, COSTS["sole"], COSTS["sole"]) for name in names),
            ComTask(COSTS["com"]),
            FrameTask(torso, 0.0, COSTS["torso"]),
            PostureTask(COSTS["posture"]),
        ]
        for task in self._tasks:
            task.set_target_from_configuration(self._configuration)
        self._q = q
        self.velocity = np.zeros(model.nv)

    def prepare(self, state: RobotState) -> None:
        """Copy the state."""
        self._q = state.q.copy()

    def step(self) -> None:
        """Kinematics, problem, solution."""
        self._configuration.update(self._q)
        self.velocity = self._solve(self._configuration, self._tasks, PERIOD, solver=SOLVER)


class MinkTick:
    """mink's ``solve_ik`` on the same tasks, in MuJoCo.

    Args:
        model: The robot.

    Attributes:
        velocity: Last answer (nv,) [m/s, rad/s], in MuJoCo's order.
    """

    def __init__(self, model: RobotModel) -> None:
        import mink

        self._model = model
        self._mujoco = mujoco = build_mujoco(model, timestep=PERIOD)
        self._solve = mink.solve_ik
        q, _ = pin_to_mujoco(model, mujoco, model.standing_configuration(), np.zeros(model.nv))
        self._configuration = mink.Configuration(mujoco.model, q=q)
        names = [mujoco.model.site(site).name for site in mujoco.sole_sites]
        frame = mujoco.model.body(mujoco.bodies["torso"]).name
        self._tasks: list[Any] = [
            *(mink.FrameTask(name, "site", COSTS["sole"], COSTS["sole"]) for name in names),
            mink.ComTask(COSTS["com"]),
            mink.FrameTask(frame, "body", 0.0, COSTS["torso"]),
            mink.PostureTask(mujoco.model, COSTS["posture"]),
        ]
        for task in self._tasks:
            task.set_target_from_configuration(self._configuration)
        self._limits = [mink.ConfigurationLimit(mujoco.model)]
        self._q = q
        self.velocity = np.zeros(model.nv)

    def prepare(self, state: RobotState) -> None:
        """Copy the state."""
        self._q, _ = pin_to_mujoco(self._model, self._mujoco, state.q, state.v)

    def step(self) -> None:
        """Kinematics, problem, solution."""
        self._configuration.update(self._q)
        self.velocity = self._solve(self._configuration, self._tasks, PERIOD, solver=SOLVER, limits=self._limits)
