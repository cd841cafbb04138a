"""Joint trajectories: validation, and smooth interpolation of the points."""

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
    """Smooth curve through the points of a joint trajectory; does not validate, see ``validate_trajectory``.

    On each segment of length T, with u = (t - t_i) / T, every joint follows the quintic q(u) = sum_k c_k u^k with given
    position, velocity and acceleration at both ends. Position, velocity and acceleration are continuous.

    Accelerations, and velocities that the trajectory omits, come from ``models/spline.py``. If the first point is later
    than t = 0, the curve starts at ``start_q`` (nj,) [rad] with ``start_v`` (nj,) [rad/s], at rest when None. A first
    point at t = 0 is replaced by ``start_q``, so that the curve has no step. Joints that are not in the trajectory hold
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
        """Position, velocity, acceleration, each (nj,), at t [s]; the start before 0, at rest after the end."""
        if t >= self.duration or len(self._times) < 2:
            # Copies: a read-only array would trigger a compilation of the compiled law within the control loop.
            return self._end[0].copy(), self._end[1].copy(), self._end[2].copy()
        i, u, length = self._locate(t)
        curve = np.empty(self._end.shape)
        evaluate_quintic(self.coefficients, i, u, length, curve)
        return curve[0], curve[1], curve[2]

    def effort(self, t: float) -> Vector:
        """Feed-forward torque, linear between points (nj,) [N.m]; zero for a trajectory without efforts."""
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
        """Index of the segment, normalised time in it, and its length [s]."""
        i = max(bisect_right(self._times, t) - 1, 0)
        length = self._times[i + 1] - self._times[i]
        return i, max((t - self._times[i]) / length, 0.0), length


def fill_points(
    traj: JointTrajectory, columns: NDArray[np.intp], nj: int, start_q: Vector, start_v: Vector | None
) -> tuple[Vector, Matrix, Matrix, Matrix | None]:
    """Times (m,), positions, velocities and optional torques (m, nj), with a lead-in from ``start_q`` if needed."""
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

    points_max: Annotated[int, Field(gt=0)]  #: maximum number of points in one trajectory [1]
    start_jump: Positive  #: maximum step from the joint position to the first point [rad]
    position_tolerance: NonNegative  #: maximum excess of a point over the joint limits [rad]
    overshoot_tolerance: NonNegative  #: maximum excess of the curve over the joint limits [rad]
    velocity_tolerance: NonNegative  #: allowed relative excess over the velocity limit [1]
    effort_tolerance: NonNegative  #: allowed relative excess over the torque limit [1]
    checks_per_segment: Count  #: number of checks of the curve between two points [1]


def validate_trajectory(
    traj: JointTrajectory,
    model: RobotModel,
    *,
    start_q: Vector | None = None,
    start_v: Vector | None = None,
    elapsed: float = 0.0,
) -> None:
    """Validate a trajectory for execution on the robot.

    The trajectory starts at ``start_q`` (nj,) [rad] with ``start_v`` (nj,) [rad/s]; ``elapsed`` is the age of
    ``start_q`` [s]. Without ``start_q`` only the points are checked.

    Raises ``JointNameError`` for an unknown or duplicate joint, and ``TrajectoryError`` for a wrong shape, too few or
    too many points, NaN or infinity, times that are negative or do not increase, a point outside position, velocity or
    torque limits, a curve outside position or velocity limits, or a start jump; the message names field, point, joint.
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
    """Checks of one trajectory; each raises on failure. ``columns`` is the joint index of each column (k,)."""

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
        """Check the sampled curve between the points against position and velocity limits."""
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
        inside = start_q[columns]  # a joint that starts outside may return
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
    """Joint index of each column (k,); raises ``JointNameError``, or ``TrajectoryError`` without any joint name."""
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
    """Keep every n-th point of a dense trajectory and the last, at most ``points_max`` (2 or more)."""
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
