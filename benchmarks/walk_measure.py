"""What a walk was like, by the true state of the robot: velocity, power, tracking error."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from bridge.closed_loop import ClosedLoop
from models.constants import GRAVITY
from models.heading import heading
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
        trace: Signals of its last seconds by name; see ``_signals``.
    """

    velocities: Matrix
    distance: float
    energy: float
    trace: dict[str, list[float]] = field(default_factory=dict)

    @property
    def mean(self) -> Vector:
        """Mean velocity (3,) [m/s, m/s, rad/s]; zero when it fell before the first chunk."""
        if not len(self.velocities):
            return np.zeros(3)
        mean: Vector = self.velocities.mean(axis=0)
        return mean


TRACED = ("t", "dcm_ahead", "dcm_left", "cmp_ahead", "cmp_left", "yaw", "load_left", "load_right", "torque_share")
"""Columns of a trace; see ``_signals``."""


def _signals(loop: ClosedLoop) -> Matrix:
    """What tells why a robot fell, from the log (n, 9).

    Stamp [s]; DCM and commanded CMP from the middle of the base, along its heading and to its left [m]; yaw [rad];
    vertical force on each foot over the weight [-]; torque over its limit of the joint that is nearest to it [-].
    """
    log, weight = loop.log, loop.robot.mass * GRAVITY
    yaw = np.array([heading(*q[3:7]) for q in log.true_q])
    seen = np.array([heading(*q[3:7]) for q in log.estimate_q])  # the controller's points are in its own frame
    c, s = np.cos(seen), np.sin(seen)
    points = []
    for point in (log.dcm, log.zmp):
        x, y = (point - log.estimate_q[:, :2]).T
        points += [c * x + s * y, c * y - s * x]
    loads = [log.wrenches[:, 2] / weight, log.wrenches[:, 8] / weight]
    return np.column_stack([log.t, *points, yaw, *loads, (np.abs(log.tau) / loop.robot.tau_max).max(axis=1)])


def watch(loop: ClosedLoop, duration: float, chunk: float, trace_time: float = 0.0) -> Walked:
    """Let a robot walk for a time, or until it falls, and measure it.

    Args:
        loop: The robot; its log, which this empties, gives the power.
        duration: [s].
        chunk: Between two samples of the robot's place [s].
        trace_time: How much of the end to keep signals of, should it fall [s].
    """
    velocities, distance, energy = [], 0.0, 0.0
    signals: deque[Matrix] = deque(maxlen=max(round(trace_time / chunk), 1))
    end = loop.t + duration
    loop.log.clear()
    before = loop.truth.q[:7].copy()
    while loop.t < end - 1e-9 and not loop.fallen:  # 1e-9: rounding of the simulated time
        loop.run(chunk)
        now = loop.truth.q[:7].copy()
        first, last = heading(*before[3:]), heading(*now[3:])
        turned = (last - first + math.pi) % (2.0 * math.pi) - math.pi
        c, s = math.cos(first + 0.5 * turned), math.sin(first + 0.5 * turned)
        x, y = now[:2] - before[:2]
        velocities.append(np.array([c * x + s * y, c * y - s * x, turned]) / chunk)
        distance += math.hypot(x, y)
        power = np.abs(loop.log.tau * loop.log.true_v[:, 6:]).sum(axis=1)  # (n,)
        energy += float(power.mean()) * chunk
        signals.append(_signals(loop))
        loop.log.clear()
        before = now
    trace = {}
    if loop.fallen and trace_time > 0.0 and signals:
        trace = {name: column.round(4).tolist() for name, column in zip(TRACED, np.vstack(signals).T, strict=True)}
    return Walked(np.array(velocities).reshape(-1, 3), distance, energy, trace)


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
