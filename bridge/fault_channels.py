"""Which numbers of a sample, or which torques, belong to the target of a fault, and how large they can be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bridge.fault_plan import Fault
from models.constants import GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import FOOT_NAMES, Vector

STAMPS, SCAN = "stamps", "scan"

IMU, JOINT_STATES = "imu", "joint_states"
FEET = tuple(f"foot:{name}" for name in FOOT_NAMES)
"""Sources of messages; targets of the same name."""


@dataclass(frozen=True, slots=True)
class Channels:
    """The numbers of one target.

    Attributes:
        index: Where they are (n,): among the joint torques for motors, among the readings of a scan for 'scan', among
            positions, velocities and torques of all joints and the stamp for 'joint_states' and 'stamps', among the
            channels of ``SensorNoise`` otherwise.
        low, high: Full scale (n,).
        blocks: Equal parts of ``index`` of which the first is what parameters speak of; encoders have two, positions
            and velocities, 'joint_states' three.
        sources: Messages that are missing when the target says nothing.
        derived: Whether a value at rest means velocities of zero, as in an encoder.
    """

    index: NDArray[np.intp]
    low: Vector
    high: Vector
    blocks: int = 1
    sources: frozenset[str] = frozenset()
    derived: bool = False

    @property
    def first(self) -> NDArray[np.bool_]:
        """Which of the numbers belong to the first block (n,)."""
        return np.arange(len(self.index)) < len(self.index) // self.blocks

    def spread(self, name: str, value: object) -> Vector:
        """A parameter, given once or for each number of the first block, for all of them (n,).

        Raises:
            ConfigError: It has another number of elements; names the parameter.
        """
        size = len(self.index) // self.blocks
        given = np.asarray(value, dtype=np.float64)
        if given.shape not in ((), (size,)):
            raise ConfigError(f"{name}: {given.size} numbers, expected 1 or {size}")
        return np.tile(np.broadcast_to(given, (size,)), self.blocks)


def channels_of(fault: Fault, model: RobotModel) -> Channels:
    """The numbers that a fault is about.

    Raises:
        ConfigError: The robot has no such joint, the known ones being listed, or no scanner.
    """
    nj = model.nj
    joints = np.arange(nj)
    if fault.joint:
        if fault.joint not in model.joint_names:
            known = ", ".join(model.joint_names)
            raise ConfigError(f"fault {fault}: {model.name}: unknown joint '{fault.joint}'; known: {known}")
        joints = joints[[model.joint_index(fault.joint)]]
    low, high = _full_scale(model)
    if fault.is_motor:
        return Channels(joints, -model.tau_max[joints], model.tau_max[joints])
    group = fault.target.partition(":")[0]
    if group in ("joint", "joints"):
        index = np.concatenate([joints, nj + joints])
        return Channels(index, low[index], high[index], blocks=2, derived=True)
    if group == JOINT_STATES:
        index = np.arange(3 * nj)
        return Channels(index, low[index], high[index], blocks=3, sources=frozenset({JOINT_STATES}))
    if group == STAMPS:
        return Channels(np.array([3 * nj]), np.zeros(1), np.zeros(1))
    if group == SCAN:
        return _scan_channels(model)
    if group in ("torque", "torques"):
        index, sources = 2 * nj + joints, frozenset[str]()
    else:
        at, size, sources = _PARTS[fault.target]
        index = 3 * nj + at + np.arange(size)
    return Channels(index, low[index], high[index], sources=sources)


_PARTS = {
    "imu": (0, 6, frozenset({IMU})),
    "imu.gyro": (0, 3, frozenset({IMU})),
    "imu.accel": (3, 3, frozenset({IMU})),
    "feet": (6, 12, frozenset(FEET)),
    FEET[0]: (6, 6, frozenset({FEET[0]})),
    FEET[1]: (12, 6, frozenset({FEET[1]})),
}
"""First channel behind the joints, number of channels, and messages of inertial unit and feet."""


def _scan_channels(model: RobotModel) -> Channels:
    """The readings of the scanner."""
    scan = model.profile.sensors.scan
    if scan is None:
        raise ConfigError(f"fault of scan: {model.name}: the profile has no scanner")
    low, high = np.full(scan.rays, scan.range_min), np.full(scan.rays, scan.range_max)
    return Channels(np.arange(scan.rays), low, high, sources=frozenset({SCAN}))


def _full_scale(model: RobotModel) -> tuple[Vector, Vector]:
    """Least and greatest value of every channel of ``SensorNoise``."""
    imu, feet = model.profile.sensors.imu, model.profile.sensors.feet
    weight = model.mass * GRAVITY
    force = feet.force_range or 2.0 * weight  # a sensor that is fit for the robot bears a landing on one foot
    torque = feet.torque_range or force * max(model.feet[0].rectangle)  # ... on the sole's edge
    joints = [model.v_max, model.tau_max]
    tail = np.repeat([imu.gyro_range, imu.accel_range, force, torque, force, torque], 3)
    high = np.concatenate([*joints, tail])
    return np.concatenate([model.q_lower, -high]), np.concatenate([model.q_upper, high])
