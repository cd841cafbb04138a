"""What a walk was like, by the true state of the robot: velocity, power, tracking error."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.contender_loop import AnyLoop
from models.heading import heading, turned
from models.types import Matrix, Vector

Velocity = tuple[float, float, float]
"""Forward [m/s], left [m/s], turn [rad/s], in the body's frame."""


@dataclass(frozen=True, slots=True)
class Walked:
    """What a walk was like.

    Attributes:
        velocities: Mean body velocity of each chunk, in the heading of that moment (n, 3) [m/s, m/s, rad/s].
        distance: Length of the path [m].
        energy: Mechanical work of the joints, braking counted like driving [J].
    """

    velocities: Matrix
    distance: float
    energy: float

    @property
    def mean(self) -> Vector:
        """Mean velocity (3,) [m/s, m/s, rad/s]; zero when it fell before the first chunk."""
        if not len(self.velocities):
            return np.zeros(3)
        mean: Vector = self.velocities.mean(axis=0)
        return mean


def watch(loop: AnyLoop, duration: float, chunk: float) -> Walked:
    """Let a robot walk for a time, or until it falls, and measure it.

    Args:
        loop: The robot; its log gives the power.
        duration: [s].
        chunk: Between two samples of the robot's place [s].
    """
    velocities, distance, energy = [], 0.0, 0.0
    end = loop.t + duration
    before = loop.truth.q[:7].copy()
    while loop.t < end - 1e-9 and not loop.fallen:  # 1e-9: rounding of the simulated time
        rows = len(loop.log)
        loop.run(chunk)
        now = loop.truth.q[:7].copy()
        first, last = heading(*before[3:]), heading(*now[3:])
        turn = (last - first + math.pi) % (2.0 * math.pi) - math.pi
        moved = now[:2] - before[:2]
        velocities.append(np.array([*turned(moved, -(first + 0.5 * turn)), turn]) / chunk)
        distance += math.hypot(*moved)
        power = np.abs(loop.log.tau[rows:] * loop.log.true_v[rows:, 6:]).sum(axis=1)  # (n,)
        energy += float(power.mean()) * chunk
        before = now
    return Walked(np.array(velocities).reshape(-1, 3), distance, energy)


def speed_error(mean: Vector, command: Velocity) -> float:
    """Distance of a mean velocity from the command, relative to the command [-].

    Metres per second and radians per second are added as they are: a command is either straight or a turn.
    """
    return float(np.linalg.norm(mean - np.array(command)) / np.linalg.norm(command))


def tracking_error(velocities: Matrix, commands: Matrix, count: int) -> float:
    """RMS of the velocity, averaged over ``count`` chunks, off the command averaged likewise; linear only [m/s]."""
    if len(velocities) < count:
        return math.nan
    kernel = np.ones(count) / count
    errors = [np.convolve(velocities[:, i] - commands[:, i], kernel, mode="valid") for i in range(2)]
    return float(np.sqrt(np.mean(errors[0] ** 2 + errors[1] ** 2)))
