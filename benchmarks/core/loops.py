"""Common parts of the closed-loop benchmarks: required commands, falls, torque steps, search for a bound."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np
from pydantic.dataclasses import dataclass as schema

from bridge.closed_loop import ClosedLoop
from models.config import STRICT, Positive
from models.errors import PoiseError
from models.types import JointCommand, Vector


def demand(loop: ClosedLoop, command: str) -> None:
    """Send a command that must be accepted; ``PoiseError`` has command and reason if it is refused."""
    reply = loop.command(command)
    if not reply.accepted:
        raise PoiseError(f"{command}: {reply.reason}")


def start_walk(loop: ClosedLoop, forward: float, left: float = 0.0, turn: float = 0.0) -> None:
    """Send ``walk`` and a velocity [m/s, m/s, rad/s]."""
    demand(loop, "walk")
    loop.set_velocity(forward, left, turn)


def keep_upright(loop: ClosedLoop) -> None:
    """Raise ``PoiseError`` with the reason if the robot has fallen."""
    if loop.fallen:
        raise PoiseError(f"{loop.robot.name} fell: {loop.fall_reason}")


def advance(loop: ClosedLoop, duration: float) -> None:
    """Run for a time [s]; ``PoiseError`` if the robot falls."""
    loop.run(duration)
    keep_upright(loop)


ROUNDING = 1e-9  # relative tolerance for a step at the drivers' limit [-]


class TorqueSteps:
    """``largest`` torque step written in one tick, as a fraction of the rate limit [-]; infinite for NaN torques."""

    def __init__(self, loop: ClosedLoop) -> None:
        self.largest = 0.0
        self._loop = loop
        self._before: Vector | None = None

    def forget(self) -> None:
        """Discard the last torques because the robot starts over."""
        self._before = None

    def within(self, limit: float) -> bool:
        """Whether no step exceeded a limit [-]."""
        return self.largest <= limit * (1.0 + ROUNDING)

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Observe every tick within the context."""
        plant = self._loop.plant
        write, scale = plant.write, self._loop.robot.tau_rate_max * plant.period

        def watched(command: JointCommand) -> None:
            tau = self._loop.drivers.torque
            if self._before is not None:
                step = float((np.abs(tau - self._before) / scale).max())
                self.largest = max(self.largest, np.inf if np.isnan(step) else step)
            self._before = tau.copy()
            write(command)

        with patch.object(plant, "write", watched):
            yield


@schema(frozen=True, slots=True, config=STRICT)
class Search:
    """Settings of ``largest``, in the unit of the value: strides to a bracket, then bisects down to ``resolution``."""

    first: Positive
    largest: Positive
    stride: Positive
    resolution: Positive


def largest(holds: Callable[[float], bool], search: Search) -> tuple[float, int]:
    """Search the largest value for which ``holds`` is true; returns it (0 if none) and the number of tries."""
    low, high, value, tried = 0.0, math.inf, search.first, 0
    while high - low > search.resolution:
        tried += 1
        if holds(value):
            low = value
            if low >= search.largest:
                break
        else:
            high = value
        if math.isinf(high):
            value = min(low + search.stride, search.largest)
        elif low == 0.0:
            value = max(high - search.stride, 0.5 * high)
        else:
            value = 0.5 * (low + high)
    return low, tried
