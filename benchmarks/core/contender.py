"""Run any controller in the tests of poise: it receives the sensors and returns a joint command each tick."""

from dataclasses import replace
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Protocol

import numpy as np

from benchmarks.contenders.onnx_policy import OnnxPolicy
from benchmarks.core.provenance import is_policy
from bridge.closed_loop import ClosedLoop
from bridge.plants.config import LoopConfig
from controllers.joints.joint_servo import JointServo
from controllers.stack import ControlStack
from models.config import default_config
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import (
    CommandReply,
    ContactState,
    ControlResult,
    JointCommand,
    JointTrajectory,
    Mode,
    RobotState,
    SensorData,
    SolveStatus,
    Vector,
)


class Contender(Protocol):
    """Controller under test."""

    #: Whether its torques are applied directly. Otherwise the drivers run the joint PD with the gains of the robot's
    #: profile on its desired positions and velocities, and add its torques
    torque_controlled: bool

    def reset(self, model: RobotModel, seed: int) -> None:
        """Start over with the robot held in the posture 'stand'; ``seed`` is for controllers with random numbers."""

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Set the desired walking velocity [m/s, m/s, rad/s], in the frame of the body; zero means stand."""

    def step(self, sensors: SensorData, dt: float) -> JointCommand:
        """Compute one tick, ``dt`` [s] after the last one, from measured joints, IMU and foot wrenches."""


def load(name: str) -> Contender:
    """Create a contender from ``module:Class`` or from the YAML file of an ONNX policy.

    Raises ``ConfigError`` when this fails or the class lacks a method.
    """
    if is_policy(name):
        return OnnxPolicy(Path(name))
    try:
        contender: Contender = resolve_name(name)()
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise ConfigError(
            f"contender '{name}': not a module:Class that can be made without arguments: {error}"
        ) from error
    lacking = [part for part in ("torque_controlled", "reset", "set_velocity", "step") if not hasattr(contender, part)]
    if lacking:
        raise ConfigError(f"contender '{name}' has no {', '.join(lacking)}; docs/contenders.md describes the interface")
    return contender


class ContenderStack(ControlStack):
    """Runs a contender in place of estimator, supervisor and control law; mode 'stand' after ``arm``."""

    def __init__(self, name: str, robot: RobotModel, seed: int) -> None:
        super().__init__()
        self.robot, self.contender, self.seed = robot, load(name), seed
        none, no_contact = np.zeros(0), ContactState(False, np.zeros(6))
        self.state = RobotState(0.0, none, none, none, (no_contact, no_contact))
        self.result = ControlResult(JointCommand.torque(none), SolveStatus.OPTIMAL, 0.0, none, none, none, none, none)

    def reset(self, sensors: SensorData, state: RobotState | None = None) -> RobotState:
        self.contender.reset(self.robot, self.seed)
        return self.state

    def arm(self) -> CommandReply:
        self._mode = Mode.STAND
        return CommandReply(True, "stands")

    def step(self, sensors: SensorData, dt: float, state: RobotState | None = None) -> JointCommand:
        command = self.contender.step(sensors, dt)
        return JointCommand.torque(command.tau) if self.contender.torque_controlled else command

    def supervise(self, t: float, *, drivers_damped: bool = False, hardware: tuple[str, ...] = ()) -> Mode:
        return self.mode


class DirectDrives(JointServo):
    """Drivers that apply torques without gains immediately, within the torque limits, without fade or rate limit."""

    _direct: Vector | None = None

    def command(self, cmd: JointCommand | JointTrajectory, t: float) -> bool:
        if isinstance(cmd, JointTrajectory) or cmd.kp is None or cmd.kd is None or cmd.kp.any() or cmd.kd.any():
            return super().command(cmd, t)
        self._direct = np.clip(cmd.tau, -self.model.tau_max, self.model.tau_max)
        return True

    def step(self, t: float, q: Vector, v: Vector, dt: float) -> JointCommand:
        return super().step(t, q, v, dt) if self._direct is None else JointCommand.torque(self._direct)


ANY_LOAD = 2.0  #: ``load_tolerance`` of contenders: their posture may load the feet of a held robot differently


class ContenderLoop(ClosedLoop):
    """``ClosedLoop`` with a contender; its log has only the ground truth. ``ConfigError`` for an invalid contender.

    Without ``config`` the robot is released after ``settle_time``, regardless of the load on its feet.
    """

    def __init__(self, contender: str, robot: str | RobotModel = "g1", seed: int = 0, **options: Any) -> None:
        model = robot if isinstance(robot, RobotModel) else RobotModel.load(robot)
        self._laws = ContenderStack(contender, model, seed)
        record = options.get("record_period_s") is not None
        packaged = default_config(LoopConfig, "bridge", "closed_loop")
        options.setdefault("config", replace(packaged, load_tolerance=ANY_LOAD))
        super().__init__(model, seed, record=record, stack=self._laws, drivers=DirectDrives, **options)

    @property
    def faults(self) -> tuple[str, ...]:
        return ()

    def reset(self, seed: int | None = None) -> None:
        self._laws.seed = self._laws.seed if seed is None else seed
        super().reset(seed)

    def command(self, text: str) -> CommandReply:
        """Accept a command without effect: a contender accepts velocities only."""
        return CommandReply(True, f"'{text}' has no effect: a contender accepts velocities only")

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        self._laws.contender.set_velocity(forward, left, turn)

    def _add_row(self) -> None:
        self.log.add_truth(self.plant.truth, self.plant.com)
