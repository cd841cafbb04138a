"""The smooth curve through the points of a joint trajectory."""

from __future__ import annotations

from bisect import bisect_right
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from models.spline import evaluate_quintic, monotone_velocities, quintic_coefficients
from models.types import JointTrajectory, Matrix, Vector

if TYPE_CHECKING:
    from models.robot_model import RobotModel


class TrajectorySampler:
    """Smooth curve through the points of a joint trajectory.

    On each segment of length T, with u = (t - t_i) / T, every joint follows the quintic q(u) = sum_k c_k u^k that meets
    position, velocity and acceleration at both ends, so position, velocity and acceleration are continuous.

    Velocities that the trajectory leaves out and the accelerations are those of ``models/spline.py``. A first point
    later than t = 0 is reached from ``start_q``; one at t = 0 is replaced by ``start_q``, so that the curve never
    steps. Joints that the trajectory does not name hold ``start_q``.

    Args:
        traj: Trajectory that has passed ``validate_trajectory``.
        model: Robot whose joints it names.
        start_q: Where the joints are at t = 0 (nj,) [rad].
        start_v: How fast the joints move at t = 0 (nj,) [rad/s]; zero when None. Used when the first point is later.

    Assumptions:
        The trajectory is valid; nothing is checked here.
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
        """Evaluate the curve.

        Args:
            t: Time since the start [s]; before 0 the start is returned, after the end the last point at rest.

        Returns:
            Position [rad], velocity [rad/s], acceleration [rad/s^2], each (nj,).
        """
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
    """Points of every joint of the robot, from the start on.

    Returns:
        Times (m,) [s], positions [rad], velocities [rad/s] and, where given, torques [N.m], each (m, nj). m is n, or
        n + 1 when a lead-in from ``start_q`` comes first.
    """
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
