"""A motion of arms and head, blended into the posture of a walk."""

import numpy as np
from numpy.typing import NDArray

from models.robot_model import RobotModel
from models.spline import fade_out, min_jerk
from models.trajectory import TrajectorySampler, validate_trajectory
from models.types import JointTrajectory, Matrix, Vector


def free_joints(model: RobotModel) -> NDArray[np.bool_]:
    """Whether each joint moves neither a foot nor the torso: arms and head (nj,)."""
    free = np.ones(model.nj, dtype=np.bool_)
    for frame in (*(foot.frame_id for foot in model.feet), model.frame_id("torso")):
        for joint in model.pin.supports[model.pin.frames[frame].parentJoint]:
            if joint >= 2:  # 0 is the world, 1 the floating base
                free[joint - 2] = False
    return free


class UpperBodyMotion:
    r"""Blends arms and head of a motion into and out of a posture; the rest of the motion is ignored.

    .. math::
        q = q_{ref} + w (q_m - q_{ref}), \quad w = s(\min(t, T - t) / T_f), \quad s(u) = u^3 (6 u^2 - 15 u + 10)

    with the first two derivatives of q, so that velocity and acceleration have no step while the walk swings the arms.
    When a motion is replaced or released, its contribution to the posture fades out within the time of the blend.

    ``free`` marks the joints of arms and head (nj,).
    """

    def __init__(self, model: RobotModel, fade: float) -> None:
        self._model, self._fade_time = model, fade
        self.free = free_joints(model)
        self.drop()

    @property
    def active(self) -> bool:
        """Whether a motion is being executed."""
        return self._motion is not None

    def drop(self) -> None:
        """Discard the motion and its contribution to the posture at once."""
        self._motion: TrajectorySampler | None = None
        self._t = self._end = self._fade = 0.0
        self._added = np.zeros((3, self._model.nj))  # contribution to posture, velocity and acceleration
        self._former = self._added  # contribution of the previous motion at its end
        self._since = self._fade_time  # time since that end [s]

    def release(self) -> None:
        """Discard the motion at once; its contribution to the posture fades out."""
        if not self._idle:
            self._motion, self._former, self._since = None, self._added, 0.0

    @property
    def _idle(self) -> bool:
        """Whether nothing is added to the posture."""
        return self._motion is None and self._since >= self._fade_time

    def follow(self, trajectory: JointTrajectory, posture: Vector) -> None:
        """Start a motion planned from a posture (nj,) [rad]. Raises as ``validate_trajectory`` does."""
        validate_trajectory(trajectory, self._model, start_q=posture)
        self.release()
        self._motion = TrajectorySampler(trajectory, self._model, posture)
        self._t, self._end = 0.0, self._motion.duration
        self._fade = min(self._fade_time, 0.5 * self._end)

    def stop(self) -> None:
        """Return to the walk's posture within the time of the blend, after the motion has been blended in."""
        self._end = min(self._end, max(self._t, self._fade) + self._fade)

    def step(self, posture: Vector, velocity: Vector, acceleration: Vector, dt: float) -> tuple[Vector, Vector, Vector]:
        """Return posture, velocity and acceleration with the motion blended in, ``dt`` [s] after the last tick."""
        if self._idle:
            return posture, velocity, acceleration
        self._t += dt
        self._since += dt
        if self._t >= self._end:
            self._motion = None
            if self._idle:
                self.drop()
                return posture, velocity, acceleration
        self._added = added = np.zeros((3, self._model.nj))
        if self._motion is not None:
            added += self._blended(self._motion, posture, velocity, acceleration)
        if self._since < self._fade_time:
            added += fade_out(self._former, self._since, self._fade_time)
        return posture + added[0], velocity + added[1], acceleration + added[2]

    def _blended(self, motion: TrajectorySampler, posture: Vector, velocity: Vector, acceleration: Vector) -> Matrix:
        """Contribution of the motion to posture, velocity and acceleration (3, nj)."""
        left = self._end - self._t
        u, sign = (left / self._fade, -1.0) if left < self._t else (self._t / self._fade, 1.0)
        weight, rate, bend = min_jerk(min(u, 1.0))
        rate *= sign / self._fade
        bend /= self._fade**2
        q, v, a = motion.sample(self._t)
        dq = np.where(self.free, q - posture, 0.0)
        dv = np.where(self.free, v - velocity, 0.0)
        da = np.where(self.free, a - acceleration, 0.0)
        return np.array([weight * dq, weight * dv + rate * dq, weight * da + 2.0 * rate * dv + bend * dq])
