"""A contender in the closed loop, in the place of the laws."""

from __future__ import annotations

import numpy as np

from benchmarks.core.contender import load
from bridge.closed_loop import ClosedLoop
from controllers.joints.joint_servo import JointServo
from controllers.stack import ControlStack
from models.robot_model import RobotModel
from models.terrain import FLAT, Terrain
from models.types import (
    CommandReply,
    ContactState,
    ControlResult,
    JointCommand,
    Mode,
    RobotState,
    SensorData,
    SolveStatus,
    Vector,
)


class ContenderStack(ControlStack):
    """A contender instead of estimator, supervisor and law; in mode 'stand' from ``arm`` on."""

    def __init__(self, name: str, robot: RobotModel, seed: int) -> None:
        super().__init__()
        self.robot, self.contender, self.seed = robot, load(name), seed
        none, no_contact = np.zeros(0), ContactState(False, np.zeros(6))
        self.state = RobotState(0.0, none, none, none, (no_contact, no_contact))
        self.result = ControlResult(JointCommand.torque(none), SolveStatus.OPTIMAL, 0.0, none, none, none, none, none)

    def reset(self, sensors: SensorData, state: RobotState | None = None) -> RobotState:
        """Start the contender over; its seed is that of the loop."""
        self.contender.reset(self.robot, self.seed)
        return self.state

    def arm(self) -> CommandReply:
        """No checks precede a contender."""
        self._mode = Mode.STAND
        return CommandReply(True, "stands")

    def step(self, sensors: SensorData, dt: float, state: RobotState | None = None) -> JointCommand:
        """One tick of the contender; torques alone where it controls torques."""
        command = self.contender.step(sensors, dt)
        return JointCommand.torque(command.tau) if self.contender.torque_controlled else command

    def supervise(self, t: float, *, drivers_damped: bool = False) -> Mode:
        """A contender is not supervised."""
        return self.mode


class DirectDrives(JointServo):
    """Drivers that apply torques without gains at once, within the robot's limits: no fade, no limit of their rate."""

    _direct: Vector | None = None

    def command(self, cmd: JointCommand, t: float) -> bool:
        """See ``JointServo``."""
        if cmd.kp is None or cmd.kd is None or cmd.kp.any() or cmd.kd.any():
            return super().command(cmd, t)
        self._direct = np.clip(cmd.tau, -self.model.tau_max, self.model.tau_max)
        return True

    def step(self, t: float, q: Vector, v: Vector, dt: float) -> JointCommand:
        """See ``JointServo``."""
        return super().step(t, q, v, dt) if self._direct is None else JointCommand.torque(self._direct)


class ContenderLoop(ClosedLoop):
    """``ClosedLoop`` with a contender ``module:Class``; its log has only what is true, ``faults`` is empty.

    Raises:
        ConfigError: The contender cannot be made.
        PoiseError: The feet of the held robot do not take its weight.
    """

    def __init__(
        self,
        contender: str,
        robot: str | RobotModel = "g1",
        seed: int = 0,
        *,
        terrain: str | Terrain = FLAT,
        friction: float | None = None,
        payload_kg: float = 0.0,
        delay_s: float | None = None,
        record_period_s: float | None = None,
    ) -> None:
        model = robot if isinstance(robot, RobotModel) else RobotModel.load(robot)
        self._laws = ContenderStack(contender, model, seed)
        super().__init__(
            model,
            seed,
            terrain=terrain,
            friction=friction,
            payload_kg=payload_kg,
            delay_s=delay_s,
            record=record_period_s is not None,
            record_period_s=record_period_s,
            stack=self._laws,
            drivers=DirectDrives,
        )

    @property
    def faults(self) -> tuple[str, ...]:
        """A contender has no supervisor that latches any."""
        return ()

    def reset(self, seed: int | None = None) -> None:
        """See ``ClosedLoop``."""
        self._laws.seed = self._laws.seed if seed is None else seed
        super().reset(seed)

    def command(self, text: str) -> CommandReply:
        """Accepted without effect: a contender takes velocities only."""
        return CommandReply(True, f"'{text}' left to set_velocity")

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Walking velocity of the body [m/s, m/s, rad/s]."""
        self._laws.contender.set_velocity(forward, left, turn)

    def _add_row(self) -> None:
        self.log.add_truth(self.plant.truth, self.plant.com)
