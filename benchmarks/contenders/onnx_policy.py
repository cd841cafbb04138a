r"""A policy in an ONNX file as a contender, with a YAML file of its observations, its action and its joint gains.

.. math:: q^* = q_0 + s\, a, \quad \tau = k_p (q^* - q) - k_d \dot q

with the action ``a`` of the network, at the policy's rate, and the PD in the joint drivers. Observations come from
encoders, gyro and accelerometer alone; the orientation is that of the ``OrientationFilter``. docs/contenders.md has an
example of the file.
"""

from collections import deque
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from msgspec.structs import replace
from pydantic.dataclasses import dataclass

from controllers.estimation.orientation_filter import OrientationFilter
from models.config import STRICT, Count, NonNegative, Positive, load_config
from models.errors import ConfigError, PoiseError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector

Term = Literal[
    "base_angular_velocity", "projected_gravity", "command",
    "joint_positions", "joint_velocities", "previous_action", "phase",
]  # fmt: skip


@dataclass(frozen=True, slots=True, config=STRICT)
class PolicyJoint:
    """A joint in the vectors of the policy."""

    default: float  #: Its position at an action of 0, and where its observed position is 0 [rad]
    kp: NonNegative  #: Gain of the driver [N.m/rad]
    kd: NonNegative  #: Gain of the driver [N.m.s/rad]
    scale: float = 1.0  #: Its target from the default, per action [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class Observation:
    """A part of the network's input: the values of a term, times a scale."""

    term: Term
    scale: float | tuple[float, ...] = 1.0  #: For all values, or one for each
    joints: tuple[str, ...] = ()  #: Of a term of joints: which, in this order; all of the policy when empty


@dataclass(frozen=True, slots=True, config=STRICT)
class PolicyConfig:
    """The file of a policy."""

    model: str  #: ONNX file, relative to this one; one input of observations, one output of actions
    rate: Positive  #: Of the policy [Hz]
    joints: dict[str, PolicyJoint]  #: In the order of the policy; the robot's others are held in its posture 'stand'
    observations: tuple[Observation, ...]  #: In the order of the input
    acts: tuple[str, ...] = ()  #: Joints of the action, in its order; all of the policy when empty
    history: Count = 1  #: Samples in the input, at the policy's rate, the oldest first
    stacked: Literal["terms", "samples"] = "terms"  #: Input: the history of each term, or the terms of each sample
    period: Positive = 1.0  #: Of ``phase``: sine and cosine of 2 pi t / period [s]

    def __post_init__(self) -> None:
        named = [*self.acts, *(name for each in self.observations for name in each.joints)]
        if unknown := [name for name in named if name not in self.joints]:
            raise ValueError(f"'{unknown[0]}' is not in joints")
        for each in self.observations:
            size = self.size(each)
            if isinstance(each.scale, tuple) and len(each.scale) != size:
                raise ValueError(f"{each.term}: {len(each.scale)} scales for {size} values")

    @property
    def acting(self) -> tuple[str, ...]:
        """Joints of the action."""
        return self.acts or tuple(self.joints)

    def size(self, each: Observation) -> int:
        """Number of values of a term."""
        joints = len(each.joints or self.joints)
        sizes = {"joint_positions": joints, "joint_velocities": joints, "previous_action": len(self.acting), "phase": 2}
        return sizes.get(each.term, 3)


class _Robot(NamedTuple):
    """What the policy needs of its robot."""

    mount: Any  # rotation of the IMU in the base (3, 3)
    places: dict[str, int]  # of the policy's joints in the robot's vectors


class OnnxPolicy:
    """Runs the policy at its rate and keeps its targets in between.

    Raises ``ConfigError`` for a wrong file, without ``onnxruntime``, and for a network whose input or output has not
    the size that the file says; ``reset`` for joints that the robot has not, or an IMU that is not on its base.
    """

    torque_controlled = False

    def __init__(self, file: Path) -> None:
        self.config = config = load_config(PolicyConfig, file)
        self._file, self._run = file, _session(file, config)
        self._robot: _Robot | None = None

    def reset(self, model: RobotModel, seed: int) -> None:
        """Start over; the robot stands, held."""
        joints = self.config.joints
        try:
            places = {name: model.joint_index(name) for name in joints}
        except PoiseError as error:
            raise ConfigError(f"{self._file}: joints: {error}") from error
        data, frames = model.data(), [model.pin.frames[model.frame_id(name)] for name in ("base_link", "imu")]
        if frames[0].parentJoint != frames[1].parentJoint:
            raise ConfigError(f"{self._file}: the IMU of {model.name} is not on its base, whose motion is observed")
        pin.framesForwardKinematics(model.pin, data, model.standing_configuration())
        base, imu = (data.oMf[model.frame_id(name)].rotation for name in ("base_link", "imu"))
        zero = np.zeros(model.nj)
        q, kp, kd = model.posture("stand").copy(), model.kp.copy(), model.kd.copy()
        for name, joint in joints.items():
            q[places[name]], kp[places[name]], kd[places[name]] = joint.default, joint.kp, joint.kd
        self._robot, self._command = _Robot(base.T @ imu, places), JointCommand(q, zero, zero, kp, kd)
        self._filter: OrientationFilter | None = None
        self._velocity, self._action = np.zeros(3), np.zeros(len(self.config.acting))
        self._time, self._ticks = 0.0, 0
        self._samples: deque[list[Vector]] = deque(maxlen=self.config.history)

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Velocity of the term ``command`` [m/s, m/s, rad/s]."""
        self._velocity = np.array((forward, left, turn))

    def step(self, sensors: SensorData, dt: float) -> JointCommand:
        """Targets of the joints; ``PoiseError`` before ``reset``."""
        if self._robot is None:
            raise PoiseError(f"{self._file}: step before reset")
        if self._filter is None:
            self._filter = OrientationFilter()
            self._filter.reset(np.zeros(3), sensors.accel)
        else:
            self._filter.step(sensors.gyro, sensors.accel, dt)
            self._time += dt
        config, places = self.config, self._robot.places
        if self._time * config.rate >= self._ticks - 1e-6:  # 1e-6: rounding of the time
            self._ticks += 1
            self._action = self._run(self._observe(sensors, self._robot, self._filter))
            targets = self._command.q.copy()  # the last command may still be on its way
            for name, value in zip(config.acting, self._action, strict=True):
                targets[places[name]] = config.joints[name].default + config.joints[name].scale * value
            self._command = replace(self._command, q=targets)
        return self._command

    def _observe(self, sensors: SensorData, robot: _Robot, attitude: OrientationFilter) -> Vector:
        """Input of the network (n,)."""
        config = self.config

        def values(each: Observation) -> Vector:
            names = each.joints or tuple(config.joints)
            ids = [robot.places[name] for name in names]
            turn = 2.0 * np.pi * self._time / config.period
            value = {
                "base_angular_velocity": robot.mount @ (sensors.gyro - attitude.bias),
                "projected_gravity": -robot.mount @ attitude.rotation[2],
                "command": self._velocity,
                "joint_positions": sensors.q[ids] - [config.joints[name].default for name in names],
                "joint_velocities": sensors.v[ids],
                "previous_action": self._action,
                "phase": np.array((np.sin(turn), np.cos(turn))),
            }[each.term]
            return np.asarray(value * np.asarray(each.scale))

        sample, samples = [values(each) for each in config.observations], self._samples
        samples.extend([sample] * (1 if samples else config.history))
        parts = samples if config.stacked == "samples" else zip(*samples, strict=True)
        return np.concatenate([value for part in parts for value in part])


def _session(file: Path, config: PolicyConfig) -> Any:
    """The network as a function of its input (n,) to its output (m,)."""
    try:
        import onnxruntime
    except ImportError as error:
        raise ConfigError(f"{file}: a policy needs onnxruntime: pip install 'poise[policies]'") from error
    options, model = onnxruntime.SessionOptions(), file.parent / config.model
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no common class
        raise ConfigError(f"{file}: model: {model} cannot be loaded: {error}") from error
    sizes = [config.size(each) for each in config.observations]
    terms = ", ".join(f"{each.term} {size}" for each, size in zip(config.observations, sizes, strict=True))
    wanted = {
        "input": (session.get_inputs(), config.history * sum(sizes), f"history {config.history} of {terms}"),
        "output": (session.get_outputs(), len(config.acting), "one for each joint of the action"),
    }
    for kind, (ends, size, what) in wanted.items():
        found = ", ".join(f"'{end.name}' {end.shape}" for end in ends)
        last = [(end.shape or [0])[-1] for end in ends]
        if len(ends) != 1 or (last[0] not in (size, None) and not isinstance(last[0], str)):
            raise ConfigError(f"{file}: {model.name} has the {kind} {found}; [1, {size}] expected: {what}")
    name = session.get_inputs()[0].name

    def run(values: Vector) -> Vector:
        return np.asarray(session.run(None, {name: values[None].astype(np.float32)})[0][0], dtype=np.float64)

    return run
