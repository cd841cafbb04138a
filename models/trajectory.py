"""Joint trajectories: validation, and the smooth curve through the points."""

from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, NonNegative, Positive, default_config
from models.errors import JointNameError, TrajectoryError
from models.robot_model import RobotModel
from models.spline import evaluate_quintic, monotone_velocities, quintic_coefficients
from models.types import JointTrajectory, Matrix, Vector


class TrajectorySampler:
    """Smooth curve through the points of a joint trajectory that has passed ``validate_trajectory``; checks nothing.

    On each segment of length T, with u = (t - t_i) / T, every joint follows the quintic q(u) = sum_k c_k u^k that meets
    position, velocity and acceleration at both ends, so position, velocity and acceleration are continuous.

    Velocities that the trajectory leaves out and the accelerations are those of ``models/spline.py``. A first point
    later than t = 0 is reached from ``start_q`` (nj,) [rad] at ``start_v`` (nj,) [rad/s], at rest when None; one at t =
    0 is replaced by ``start_q``, so that the curve never steps. Joints that the trajectory does not name hold
    ``start_q``.
    """

    def __init__(
        self, traj: JointTrajectory, model: RobotModel, start_q: Vector, start_v: Vector | None = None
    ) -> None:
        columns = np.array([model.joint_index(name) for name in traj.joint_names], dtype=np.intp)
        times, q, v, tau = fill_points(traj, columns, model.nj, np.asarray(start_q, dtype=np.float64), start_v)
        self.duration = float(times[-1])
        """Time of the last point [s]."""
        self.ends_moving = bool(v[-1].any())
        """Whether a joint has a velocity at the last point."""
        self._times: list[float] = times.tolist()
        self._efforts = tau
        self._end = np.zeros((3, model.nj))
        self._end[0] = q[-1]
        self._end.flags.writeable = False
        self.coefficients = quintic_coefficients(times, q, v)  # (n - 1, 6, nj)
        """Coefficients of the powers of u on each segment (n - 1, 6, nj) [rad]."""

    def sample(self, t: float) -> tuple[Vector, Vector, Vector]:
        """Position, velocity, acceleration, each (nj,), at t [s]; before 0 the start, after the end at rest."""
        if t >= self.duration or len(self._times) < 2:
            # Copies, because a compiled law would compile again, in the loop, for an array that is read-only.
            return self._end[0].copy(), self._end[1].copy(), self._end[2].copy()
        i, u, length = self._locate(t)
        curve = np.empty(self._end.shape)
        evaluate_quintic(self.coefficients, i, u, length, curve)
        return curve[0], curve[1], curve[2]

    def effort(self, t: float) -> Vector:
        """Feed-forward torque, linear between points (nj,) [N.m]; zero where the trajectory gives none."""
        if self._efforts is None:
            rest: Vector = self._end[1]
            return rest
        if t >= self.duration or len(self._times) < 2:
            last: Vector = self._efforts[-1]
            return last
        i, u, _ = self._locate(t)
        blend: Vector = (1.0 - u) * self._efforts[i] + u * self._efforts[i + 1]
        return blend

    def _locate(self, t: float) -> tuple[int, float, float]:
        """Segment, normalised time in it and its length [s]."""
        i = max(bisect_right(self._times, t) - 1, 0)
        length = self._times[i + 1] - self._times[i]
        return i, max((t - self._times[i]) / length, 0.0), length


def fill_points(
    traj: JointTrajectory, columns: NDArray[np.intp], nj: int, start_q: Vector, start_v: Vector | None
) -> tuple[Vector, Matrix, Matrix, Matrix | None]:
    """Times (m,), positions, velocities and torques, if any, (m, nj), after a lead-in from ``start_q`` if needed."""
    lead_in = int(traj.times[0] > 0.0)
    m = len(traj.times) + lead_in
    times = np.zeros(m)
    times[lead_in:] = traj.times
    q = np.tile(start_q, (m, 1))
    v = np.zeros((m, nj))
    q[1:, columns] = traj.positions[1 - lead_in :]
    if m == 1:
        q[0, columns] = traj.positions[0]
    if traj.velocities is None:
        v[:, columns] = monotone_velocities(times, q[:, columns])
    else:
        v[lead_in:, columns] = traj.velocities
    if lead_in and start_v is not None:
        v[0, columns] = start_v[columns]
    if traj.efforts is None:
        return times, q, v, None
    tau = np.zeros((m, nj))
    tau[lead_in:, columns] = traj.efforts
    tau[0, columns] = traj.efforts[0]
    return times, q, v, tau


@dataclass(frozen=True, slots=True, config=STRICT)
class TrajectoryLimits:
    """Schema of ``models/config/trajectory.yaml``."""

    points_max: Annotated[int, Field(gt=0)]  #: most points in one trajectory [1]
    start_jump: Positive  #: largest step from the joint to the first point [rad]
    position_tolerance: NonNegative  #: points outside the joint limits by at most [rad]
    overshoot_tolerance: NonNegative  #: curve outside the joint limits by at most [rad]
    velocity_tolerance: NonNegative  #: share of the velocity limit allowed on top [1]
    effort_tolerance: NonNegative  #: share of the torque limit allowed on top [1]
    checks_per_segment: Count  #: instants checked between two points [1]


def validate_trajectory(
    traj: JointTrajectory,
    model: RobotModel,
    *,
    start_q: Vector | None = None,
    start_v: Vector | None = None,
    elapsed: float = 0.0,
) -> None:
    """Refuse a trajectory that the robot must not execute.

    It starts at ``start_q`` (nj,) [rad], which is ``elapsed`` seconds old, with ``start_v`` [rad/s]; without
    ``start_q`` the points alone are checked.

    Raises ``JointNameError`` for a joint that is unknown or named twice, and ``TrajectoryError`` for a wrong shape, too
    few or too many points, NaN or infinity, times that are negative or do not increase, a point or the curve between
    points outside position, velocity or torque limits, or a start jump; the message names field, point and joint.
    """
    check = _Check(traj, model)
    check.shapes()
    check.finite()
    check.times()
    check.points()
    if start_q is not None:
        check.start(start_q, elapsed)
        check.curve(start_q, start_v)


class _Check:
    """Checks of one trajectory, which raise; ``columns`` is the joint of each of its columns (k,)."""

    def __init__(self, traj: JointTrajectory, model: RobotModel) -> None:
        self.traj, self.model, self.columns = traj, model, _check_names(traj, model)
        self.limits = default_config(TrajectoryLimits, "models", "trajectory")

    def shapes(self) -> None:
        if self.traj.times.ndim != 1:
            raise TrajectoryError(f"times: expected one axis, found shape {self.traj.times.shape}")
        n, k = len(self.traj.times), len(self.traj.joint_names)
        if n == 0:
            raise TrajectoryError("times: the trajectory has no points")
        if n > self.limits.points_max:
            raise TrajectoryError(f"times: {n} points, at most {self.limits.points_max}")
        for field, values in _fields(self.traj):
            if values.shape != (n, k):
                raise TrajectoryError(f"{field}: expected {n} points of {k} joints, found shape {values.shape}")

    def finite(self) -> None:
        bad = np.flatnonzero(~np.isfinite(self.traj.times))
        if bad.size:
            raise TrajectoryError(f"times: point {bad[0]} is {self.traj.times[bad[0]]}")
        for field, values in _fields(self.traj):
            self.refuse(~np.isfinite(values), lambda i, k: f"{field} is {values[i, k]}")  # noqa: B023

    def times(self) -> None:
        times = self.traj.times
        if times[0] < 0.0:
            raise TrajectoryError(f"times: point 0 is at {times[0]:g} s, before the start")
        late = np.flatnonzero(np.diff(times) <= 0.0)
        if late.size:
            i = int(late[0]) + 1
            kind = "equal to" if times[i] == times[i - 1] else "before"
            raise TrajectoryError(f"times: point {i} at {times[i]:g} s is {kind} point {i - 1} at {times[i - 1]:g} s")

    def points(self) -> None:
        traj, model, limits, columns = self.traj, self.model, self.limits, self.columns
        low, high = model.q_lower[columns], model.q_upper[columns]
        q, tol = traj.positions, limits.position_tolerance
        self.refuse(
            (q < low - tol) | (q > high + tol),
            lambda i, k: f"position {q[i, k]:g} rad outside [{low[k]:g}, {high[k]:g}]",
        )
        for values, limit, tolerance, what in (
            (traj.velocities, model.v_max[columns], limits.velocity_tolerance, "velocity [rad/s]"),
            (traj.efforts, model.tau_max[columns], limits.effort_tolerance, "effort [N.m]"),
        ):
            if values is not None:
                text = f"{what} {{:g}} beyond the limit {{:g}}"
                beyond = np.abs(values) > limit * (1.0 + tolerance)
                self.refuse(beyond, lambda i, k: text.format(values[i, k], limit[k]))  # noqa: B023

    def start(self, start_q: Vector, elapsed: float) -> None:
        present, reach = start_q[self.columns], self.model.v_max[self.columns]  # (k,)
        allowed = self.limits.start_jump + reach * (float(self.traj.times[0]) + elapsed)  # (k,)
        jump = self.traj.positions[0] - present  # (k,)
        self.refuse(
            (np.abs(jump) > allowed)[None],
            lambda _, k: (
                f"start jump of {jump[k]:g} rad from {present[k]:g} rad, at most {allowed[k]:g} rad: "
                "give the first point more time"
            ),
        )

    def curve(self, start_q: Vector, start_v: Vector | None) -> None:
        """Position and velocity limits of the sampled curve between the points."""
        traj, model, columns = self.traj, self.model, self.columns
        times, q, v, _ = fill_points(traj, columns, model.nj, np.asarray(start_q, dtype=np.float64), start_v)
        if len(times) < 2:
            return
        first = len(traj.times) - len(times)  # -1 when the curve has a lead-in from start_q
        u = (np.arange(self.limits.checks_per_segment) + 0.5) / self.limits.checks_per_segment  # (m,)
        c = quintic_coefficients(times, q, v)[:, :, columns]  # (n - 1, 6, k)
        powers = u[:, None] ** np.arange(6)  # (m, 6)
        slopes = np.arange(6) * np.where(np.arange(6) > 0, u[:, None] ** np.maximum(np.arange(6) - 1, 0), 0.0)  # (m, 6)
        position = powers @ c  # (n - 1, m, k)
        velocity = np.abs(slopes @ c).max(axis=1) / np.diff(times)[:, None]  # (n - 1, k)
        tol = self.limits.overshoot_tolerance
        low, high = model.q_lower[columns] - tol, model.q_upper[columns] + tol
        inside = start_q[columns]  # a joint that already is outside may come back in
        low, high = np.minimum(low, inside - tol), np.maximum(high, inside + tol)
        outside: NDArray[np.bool_] = np.any((position < low) | (position > high), axis=1)  # (n - 1, k)
        self.refuse(outside, lambda i, k: f"the curve after this point leaves [{low[k]:g}, {high[k]:g}] rad", first)
        most = model.v_max[columns]
        self.refuse(
            velocity > most * (1.0 + self.limits.velocity_tolerance),
            lambda i, k: (
                f"the curve after this point reaches {velocity[i, k]:g} rad/s, beyond the limit {most[k]:g}: "
                f"give it {(times[i + 1] - times[i]) * velocity[i, k] / most[k]:.2g} s or more"
            ),
            first,
        )

    def refuse(self, bad: NDArray[np.bool_], describe: Callable[[int, int], str], offset: int = 0) -> None:
        """Raise for the first True of ``bad`` (n, k), naming point (row plus ``offset``) and joint."""
        if bad.any():
            i, k = (int(index) for index in np.argwhere(bad)[0])
            where = f"point {i + offset}" if i + offset >= 0 else "start"
            raise TrajectoryError(f"joint '{self.traj.joint_names[k]}', {where}: {describe(i, k)}")


def _check_names(traj: JointTrajectory, model: RobotModel) -> NDArray[np.intp]:
    """Column of each named joint (k,); raises ``JointNameError`` or, when no joint is named, ``TrajectoryError``."""
    if not traj.joint_names:
        raise TrajectoryError("joint_names: empty")
    columns = np.array([model.joint_index(name) for name in traj.joint_names], dtype=np.intp)
    seen: set[int] = set()
    for name, column in zip(traj.joint_names, columns.tolist(), strict=True):
        if column in seen:
            raise JointNameError(f"joint_names: '{name}' is given twice")
        seen.add(column)
    return columns


def _fields(traj: JointTrajectory) -> Iterator[tuple[str, Matrix]]:
    yield "positions", traj.positions
    if traj.velocities is not None:
        yield "velocities", traj.velocities
    if traj.efforts is not None:
        yield "efforts", traj.efforts


def thin(trajectory: JointTrajectory, points_max: int) -> JointTrajectory:
    """Every n-th point of a dense trajectory and the last, at most ``points_max`` (2 or more)."""
    count = len(trajectory.times)
    if count <= points_max:
        return trajectory
    step = -(-(count - 1) // (points_max - 1))
    kept = np.append(np.arange(0, count - 1, step), count - 1)
    velocities, efforts = trajectory.velocities, trajectory.efforts
    return replace(
        trajectory,
        times=trajectory.times[kept],
        positions=trajectory.positions[kept],
        velocities=None if velocities is None else velocities[kept],
        efforts=None if efforts is None else efforts[kept],
    )
