"""What each kind of fault makes of the numbers of its target, tick by tick."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np

from bridge.fault_channels import Channels
from bridge.fault_plan import Fault
from models.errors import ConfigError
from models.types import Vector


class Effect(Protocol):
    """A fault at work.

    Attributes:
        missing: Whether the target said nothing in the last tick.
    """

    missing: bool

    def __call__(self, k: int, x: Vector) -> Vector:
        """What comes out (n,) instead of the true values x (n,), k ticks after the beginning; x may be kept."""
        ...


class Mapped:
    """Values that depend on the true ones and the time: y = f(k, x).

    Args:
        f: Of the ticks since the beginning and the true values (n,).
    """

    missing = False

    def __init__(self, f: Callable[[int, Vector], Vector]) -> None:
        self._f = f

    def __call__(self, k: int, x: Vector) -> Vector:
        """See ``Effect``."""
        return self._f(k, x)


class Lost:
    """Values that are lost in some ticks; the last one stands in for a while, then ``fill`` does.

    Args:
        lost: Whether the value of a tick is.
        before: Value before the fault (n,).
        grace: Ticks for which the last value stands in [-].
        fill: What comes then.
    """

    def __init__(self, lost: Callable[[int], bool], before: Vector, grace: float, fill: float) -> None:
        self.missing = False
        self._lost, self._grace, self._fill = lost, grace, fill
        self._last, self._last_k = before, -1

    def __call__(self, k: int, x: Vector) -> Vector:
        """See ``Effect``."""
        self.missing = self._lost(k)
        if not self.missing:
            self._last, self._last_k = x, k
            return x
        return self._last if k - self._last_k <= self._grace else np.full(len(x), self._fill)


class Delayed:
    """Values of some ticks ago; that before the fault until the first one comes.

    Args:
        ticks: Their age.
        before: Value before the fault (n,).
    """

    missing = False

    def __init__(self, ticks: int, before: Vector) -> None:
        self._ticks, self._out = ticks, before
        self._line: deque[tuple[int, Vector]] = deque()

    def __call__(self, k: int, x: Vector) -> Vector:
        """See ``Effect``."""
        self._line.append((k, x))
        while self._line and self._line[0][0] <= k - self._ticks:
            self._out = self._line.popleft()[1]
        return self._out


def effect_of(
    fault: Fault, channels: Channels, before: Vector, period: float, grace: float, rng: np.random.Generator
) -> Effect:
    """The effect of a fault.

    Args:
        fault: What is wrong.
        channels: With which numbers.
        before: Their values before the fault (n,).
        period: Length of a tick [s].
        grace: Ticks for which the last value stands in for a message that does not come; 0 for what is no message.
        rng: For what is random.

    Raises:
        ConfigError: A parameter does not fit the target; names it.
    """
    try:
        return _effect(fault, channels, before, period, grace, rng)
    except ConfigError as error:
        raise ConfigError(f"fault {fault}: {error}") from error


def _effect(
    fault: Fault, channels: Channels, before: Vector, period: float, grace: float, rng: np.random.Generator
) -> Effect:
    fill = 0.0 if fault.is_motor else math.nan
    match fault.kind:
        case "off":
            return Lost(lambda k: True, before, grace, fill)
        case "intermittent":
            return Lost(_interruptions(fault, period, rng), before, grace, fill)
        case "slow":
            # a register keeps its value; only a message is missed when it does not come
            return Lost(_pauses(fault, period), before, grace if channels.sources else math.inf, fill)
        case "delayed":
            return Delayed(max(round((fault.delay or 0.0) / period), 1), before)
        case "stuck":
            return _constant(fault, channels, before)
        case "wrong":
            return _wrong(fault, channels, period)
        case _:
            return _bounded(fault, channels, rng)


def _interruptions(fault: Fault, period: float, rng: np.random.Generator) -> Callable[[int], bool]:
    if fault.period is None:
        probability = fault.probability or 0.0
        return lambda k: bool(rng.random() < probability)
    length = max(round(fault.period / period), 1)
    lost = round((0.5 if fault.share is None else fault.share) * length)
    return lambda k: k % length < lost


def _pauses(fault: Fault, period: float) -> Callable[[int], bool]:
    """Ticks without a new value: those in which the count of values at the rate does not grow; the first has one."""
    per_tick = (fault.rate or 0.0) * period
    if per_tick > 1.0 + 1e-9:
        raise ConfigError(f"rate: {fault.rate} Hz is more than that of the ticks, {1.0 / period:g} Hz")
    passed = -1

    def lost(k: int) -> bool:
        nonlocal passed
        due, before = math.floor(k * per_tick + 1e-9), passed
        passed = due
        return due == before

    return lost


def _constant(fault: Fault, channels: Channels, before: Vector) -> Effect:
    held = before.copy() if fault.value is None else channels.spread("value", fault.value)
    if fault.value is not None or channels.derived:
        held[~channels.first & np.isfinite(held)] = 0.0
    return Mapped(lambda k, x: held)


def _wrong(fault: Fault, channels: Channels, period: float) -> Effect:
    if fault.value is not None:
        return _constant(fault, channels, np.zeros(len(channels.index)))
    scale = channels.spread("scale", 1.0 if fault.scale is None else fault.scale)
    offset = channels.spread("offset", 0.0 if fault.offset is None else fault.offset) * channels.first
    drift = channels.spread("drift", 0.0 if fault.drift is None else fault.drift) * channels.first * period
    return Mapped(lambda k, x: scale * x + offset + k * drift)


def _bounded(fault: Fault, channels: Channels, rng: np.random.Generator) -> Effect:
    """Random values, or the end of the range."""
    scale = channels.spread("scale", 1.0 if fault.scale is None else fault.scale)
    centre, half = 0.5 * (channels.high + channels.low), 0.5 * (channels.high - channels.low)
    if fault.kind == "garbage":
        return Mapped(lambda k, x: centre + scale * half * rng.uniform(-1.0, 1.0, len(x)))
    low, high = centre - scale * half, centre + scale * half
    if fault.scale is None:
        return Mapped(lambda k, x: np.where(x >= centre, high, low))
    return Mapped(lambda k, x: np.clip(x, low, high))
