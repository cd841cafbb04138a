r"""Contender that runs a policy from an ONNX file; a YAML file describes its observations, action and joint gains.

.. math:: q^* = q_0 + s\, a, \quad \tau = k_p (q^* - q) - k_d \dot q

The network outputs the action ``a`` at the rate of the policy; the joint drivers run the PD law. Observations use only
encoders, gyro and accelerometer; the orientation comes from ``OrientationFilter``. docs/contenders.md has an example
of the file.
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
    """Joint in the vectors of the policy."""

    default: float  #: Position at action 0, and zero of the observed position [rad]
    kp: NonNegative  #: Position gain of the driver [N.m/rad]
    kd: NonNegative  #: Velocity gain of the driver [N.m.s/rad]
    scale: float = 1.0  #: Offset of the target from the default per unit of action [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class Observation:
    """Part of the network's input: the values of a term times a scale."""

    term: Term
    scale: float | tuple[float, ...] = 1.0  #: One scale for all values, or one per value
    joints: tuple[str, ...] = ()  #: Joints of a joint term, in this order; all joints of the policy when empty


@dataclass(frozen=True, slots=True, config=STRICT)
class PolicyConfig:
    """Schema of a policy file."""

    model: str  #: ONNX file, relative to this file; one input of observations, one output of actions
    rate: Positive  #: Rate of the policy [Hz]
    joints: dict[str, PolicyJoint]  #: Joints in the order of the policy; other joints hold the posture 'stand'
    observations: tuple[Observation, ...]  #: Observations in the order of the input
    acts: tuple[str, ...] = ()  #: Joints of the action, in order; all joints of the policy when empty
    history: Count = 1  #: Number of samples in the input, taken at the rate of the policy, oldest first
    stacked: Literal["terms", "samples"] = "terms"  #: Input order: history of each term, or terms of each sample
    period: Positive = 1.0  #: Period of the term ``phase``: sine and cosine of 2 pi t / period [s]

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
        """Return the number of values of a term."""
        joints = len(each.joints or self.joints)
        sizes = {"joint_positions": joints, "joint_velocities": joints, "previous_action": len(self.acting), "phase": 2}
        return sizes.get(each.term, 3)


class _Robot(NamedTuple):
    """Properties of the robot that the policy uses."""

    mount: Any  # rotation of the IMU in the base frame (3, 3)
    places: dict[str, int]  # indices of the policy's joints in the robot's vectors


class OnnxPolicy:
    """Run the policy at its rate and hold its targets in between.

    Raises ``ConfigError`` for an invalid file, if ``onnxruntime`` is missing, or if the sizes of the network do not
    match the file. ``reset`` raises it if the robot lacks a joint, or if its IMU is not on the base.
    """

    torque_controlled = False

    def __init__(self, file: Path) -> None:
        self.config = config = load_config(PolicyConfig, file)
        self._file, self._run = file, _session(file, config)
        self._robot: _Robot | None = None

    def reset(self, model: RobotModel, seed: int) -> None:
        """Start over with the robot standing, held."""
        joints = self.config.joints
        try:
            places = {name: model.joint_index(name) for name in joints}
        except PoiseError as error:
            raise ConfigError(f"{self._file}: joints: {error}") from error
        data, frames = model.data(), [model.pin.frames[model.frame_id(name)] for name in ("base_link", "imu")]
        if frames[0].parentJoint != frames[1].parentJoint:
            raise ConfigError(f"{self._file}: the policy observes the base, but the IMU of {model.name} is not on it")
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
        """Set the velocity of the term ``command`` [m/s, m/s, rad/s]."""
        self._velocity = np.array((forward, left, turn))

    def step(self, sensors: SensorData, dt: float) -> JointCommand:
        """Return the joint targets; ``PoiseError`` before ``reset``."""
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
            targets = self._command.q.copy()  # the last command may still be in use
            for name, value in zip(config.acting, self._action, strict=True):
                targets[places[name]] = config.joints[name].default + config.joints[name].scale * value
            self._command = replace(self._command, q=targets)
        return self._command

    def _observe(self, sensors: SensorData, robot: _Robot, attitude: OrientationFilter) -> Vector:
        """Return the input of the network (n,)."""
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
    """Load the network as a function from input (n,) to output (m,)."""
    try:
        import onnxruntime
    except ImportError as error:
        raise ConfigError(f"{file}: a policy needs onnxruntime: pip install 'poise[policies]'") from error
    options, model = onnxruntime.SessionOptions(), file.parent / config.model
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions have no common class
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
