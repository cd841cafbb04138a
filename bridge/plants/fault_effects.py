"""Effects of faults: the channels that a fault changes, and their values at each tick."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bridge.plants.fault_plan import Fault
from models.constants import FOOT_NAMES, GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import Vector

STAMPS, SCAN = "stamps", "scan"

IMU, JOINT_STATES = "imu", "joint_states"
FEET = tuple(f"foot:{name}" for name in FOOT_NAMES)  #: Sources of messages; targets of the same name
Effect: TypeAlias = Callable[[int, Vector], tuple[Vector, bool]]
"""(ticks since the fault began, true values (n,)) -> (resulting values (n,), whether the message is missing).

An effect may keep a reference to the true values."""


@dataclass(frozen=True, slots=True)
class Channels:
    """The channels of one target."""

    #: Indices (n,) into the joint torques (motors), the ranges of a scan ('scan'), the positions, velocities and
    #: torques of all joints followed by the stamp ('joint_states', 'stamps'), or the channels of ``SensorNoise``
    index: NDArray[np.intp]
    low: Vector  #: Lower end of the full scale (n,)
    high: Vector  #: Upper end of the full scale (n,)
    #: Number of equal parts of ``index``; parameters apply to the first one. Encoders have two parts (positions and
    #: velocities), 'joint_states' three
    blocks: int = 1
    sources: frozenset[str] = frozenset()  #: Messages that are missing when the target is off
    derived: bool = False  #: Whether a constant value implies zero velocities, as in an encoder

    @property
    def first(self) -> NDArray[np.bool_]:
        """Whether each channel belongs to the first block (n,)."""
        return np.arange(len(self.index)) < len(self.index) // self.blocks

    def spread(self, name: str, value: object) -> Vector:
        """Expand a parameter (one number, or one per channel of the first block) to (n,); else ``ConfigError``."""
        size = len(self.index) // self.blocks
        given = np.asarray(value, dtype=np.float64)
        if given.shape not in ((), (size,)):
            raise ConfigError(f"{name}: {given.size} numbers, expected 1 or {size}")
        return np.tile(np.broadcast_to(given, (size,)), self.blocks)


#: First channel (counted after the joints), number of channels, and messages of IMU and feet
_PARTS = {
    IMU: (0, 6, frozenset({IMU})),
    "imu.gyro": (0, 3, frozenset({IMU})),
    "imu.accel": (3, 3, frozenset({IMU})),
    "feet": (6, 12, frozenset(FEET)),
    FEET[0]: (6, 6, frozenset({FEET[0]})),
    FEET[1]: (12, 6, frozenset({FEET[1]})),
}


def channels_of(fault: Fault, model: RobotModel) -> Channels:
    """The channels of a fault; ``ConfigError`` when the robot has no such joint, or no scanner."""
    nj = model.nj
    joints = np.arange(nj)
    if fault.joint:
        if fault.joint not in model.joint_names:
            known = ", ".join(model.joint_names)
            raise ConfigError(f"fault {fault}: {model.name}: unknown joint '{fault.joint}'; known: {known}")
        joints = joints[[model.joint_index(fault.joint)]]
    if fault.is_motor:
        return Channels(joints, -model.tau_max[joints], model.tau_max[joints])
    low, high = _full_scale(model)
    group = fault.target.partition(":")[0]
    if group == STAMPS:
        return Channels(np.array([3 * nj]), np.zeros(1), np.zeros(1))
    if group == SCAN:
        scan = model.profile.sensors.scan
        if scan is None:
            raise ConfigError(f"fault {fault}: {model.name}: the profile has no scanner")
        least, most = np.full(scan.rays, scan.range_min), np.full(scan.rays, scan.range_max)
        return Channels(np.arange(scan.rays), least, most, sources=frozenset({SCAN}))
    if group in ("joint", "joints"):
        index = np.concatenate([joints, nj + joints])
        return Channels(index, low[index], high[index], blocks=2, derived=True)
    if group == JOINT_STATES:
        index = np.arange(3 * nj)
        return Channels(index, low[index], high[index], blocks=3, sources=frozenset({JOINT_STATES}))
    if group in ("torque", "torques"):
        index, sources = 2 * nj + joints, frozenset[str]()
    else:
        at, size, sources = _PARTS[fault.target]
        index = 3 * nj + at + np.arange(size)
    return Channels(index, low[index], high[index], sources=sources)


def _full_scale(model: RobotModel) -> tuple[Vector, Vector]:
    """Least and greatest value of every channel of ``SensorNoise``."""
    imu, feet = model.profile.sensors.imu, model.profile.sensors.feet
    force = feet.force_range or 2.0 * model.mass * GRAVITY  # a suitable sensor measures a landing on one foot
    torque = feet.torque_range or force * max(model.feet[0].rectangle)  # at the edge of the sole
    tail = np.repeat([imu.gyro_range, imu.accel_range, force, torque, force, torque], 3)
    high = np.concatenate([model.v_max, model.tau_max, tail])
    return np.concatenate([model.q_lower, -high]), np.concatenate([model.q_upper, high])


def effect_of(
    fault: Fault, channels: Channels, before: Vector, period: float, grace: float, rng: np.random.Generator
) -> Effect:
    """Effect of a fault after values ``before`` (n,), with ``grace`` ticks of repetition; ``ConfigError`` if unfit."""
    fill = 0.0 if fault.is_motor else math.nan
    try:
        match fault.kind:
            case "off":
                return _lost(lambda k: True, before, grace, fill)
            case "intermittent":
                return _lost(_interruptions(fault, period, rng), before, grace, fill)
            case "slow":
                # a register keeps its value; only messages can be missing
                return _lost(_pauses(fault, period), before, grace if channels.sources else math.inf, fill)
            case "delayed":
                return _delayed(max(round((fault.delay or 0.0) / period), 1), before)
            case "stuck":
                return _constant(fault, channels, before)
            case "wrong":
                return _wrong(fault, channels, period)
            case _:
                return _bounded(fault, channels, rng)
    except ConfigError as error:
        raise ConfigError(f"fault {fault}: {error}") from error


def _lost(lost: Callable[[int], bool], last: Vector, grace: float, fill: float) -> Effect:
    """Loss of values: the last value is repeated for ``grace`` ticks, then replaced by ``fill``."""
    last_k = -1

    def effect(k: int, x: Vector) -> tuple[Vector, bool]:
        nonlocal last, last_k
        if lost(k):
            return last if k - last_k <= grace else np.full(len(x), fill), True
        last, last_k = x, k
        return x, False

    return effect


def _interruptions(fault: Fault, period: float, rng: np.random.Generator) -> Callable[[int], bool]:
    if fault.period is None:
        probability = fault.probability or 0.0
        return lambda k: bool(rng.random() < probability)
    length = max(round(fault.period / period), 1)
    lost = round((0.5 if fault.share is None else fault.share) * length)
    return lambda k: k % length < lost


def _pauses(fault: Fault, period: float) -> Callable[[int], bool]:
    """Ticks without a new value at the fault's rate; the first tick has one."""
    per_tick = (fault.rate or 0.0) * period
    if per_tick > 1.0 + 1e-9:
        raise ConfigError(f"rate: {fault.rate} Hz is above that of the ticks, {1.0 / period:g} Hz")
    passed = -1

    def lost(k: int) -> bool:
        nonlocal passed
        due, before = math.floor(k * per_tick + 1e-9), passed
        passed = due
        return due == before

    return lost


def _delayed(ticks: int, out: Vector) -> Effect:
    """Delay by some ticks; until the first value arrives, the result is ``out``, the value before the fault."""
    line: deque[tuple[int, Vector]] = deque()

    def effect(k: int, x: Vector) -> tuple[Vector, bool]:
        nonlocal out
        line.append((k, x))
        while line and line[0][0] <= k - ticks:
            out = line.popleft()[1]
        return out, False

    return effect


def _constant(fault: Fault, channels: Channels, before: Vector) -> Effect:
    held = before.copy() if fault.value is None else channels.spread("value", fault.value)
    if fault.value is not None or channels.derived:
        held[~channels.first & np.isfinite(held)] = 0.0
    return lambda k, x: (held, False)


def _wrong(fault: Fault, channels: Channels, period: float) -> Effect:
    if fault.value is not None:
        return _constant(fault, channels, np.zeros(len(channels.index)))
    scale = channels.spread("scale", 1.0 if fault.scale is None else fault.scale)
    offset = channels.spread("offset", fault.offset or 0.0) * channels.first
    drift = channels.spread("drift", fault.drift or 0.0) * channels.first * period
    return lambda k, x: (scale * x + offset + k * drift, False)


def _bounded(fault: Fault, channels: Channels, rng: np.random.Generator) -> Effect:
    scale = channels.spread("scale", 1.0 if fault.scale is None else fault.scale)
    centre, half = 0.5 * (channels.high + channels.low), 0.5 * (channels.high - channels.low)
    if fault.kind == "garbage":
        return lambda k, x: (centre + scale * half * rng.uniform(-1.0, 1.0, len(x)), False)
    low, high = centre - scale * half, centre + scale * half
    if fault.scale is None:
        return lambda k, x: (np.where(x >= centre, high, low), False)
    return lambda k, x: (np.clip(x, low, high), False)
