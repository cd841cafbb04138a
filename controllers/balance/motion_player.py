"""Posture of every tick: held, a motion of the whole body, or a motion of arms and head during a walk."""

from dataclasses import replace

import numpy as np

from controllers.balance.head import Head
from controllers.balance.upper_body import UpperBodyMotion
from controllers.whole_body.config import BalanceConfig
from models.config import default_config
from models.robot_model import RobotModel
from models.spline import blend_time, fade_out
from models.trajectory import TrajectoryLimits, TrajectorySampler, validate_trajectory
from models.types import JointTrajectory, Reference, Vector
from planners.motion_config import MotionConfig

STILL = 1e-9  #: Velocity up to which a joint is at rest, due to rounding [rad/s]
_POWERS = np.linspace(0.0, 1.0, 8)[:, None] ** np.arange(6)  #: Powers of 8 instants on a segment


class MotionPlayer:
    """Samples the posture that the robot holds or moves through, and adds the motion of the optional ``head``.

    When the robot has to step during a motion, arms and head continue it; legs and torso end in the 'stand' posture. A
    motion that starts while the robot steps moves arms and head only.

    ``free`` marks the joints of arms and head (nj,); ``zero`` is the velocity that ``step`` returns at rest.
    """

    def __init__(self, model: RobotModel, config: BalanceConfig, head: Head | None) -> None:
        self._model, self._config, self._head = model, config, head
        self._upper = UpperBodyMotion(model, config.motion_fade)
        self._limits = default_config(TrajectoryLimits, "models", "trajectory")
        self._planned = default_config(MotionConfig, "planners", "motion").limits
        self.free = self._upper.free
        self.zero = np.zeros(model.nj)
        self._stand = model.posture("stand")
        self.reset(self._stand)

    @property
    def active(self) -> bool:
        """Whether a motion is being executed."""
        return self._upper.active or (self._motion is not None and not self._standing_up)

    def reset(self, joints: Vector) -> None:
        """Hold joint positions (nj,) [rad], clipped to their limits."""
        self._motion: TrajectorySampler | None = None
        self._time, self._standing_up = 0.0, False
        self._fade = 0.0  # time in which ``_former`` fades out [s]
        self._legs: Vector | None = None  # posture of legs and torso while a motion moves arms and head only
        self._hold = np.clip(joints, self._model.q_lower, self._model.q_upper)
        self._last = self._hold, self.zero
        self._upper.drop()

    def follow(self, trajectory: JointTrajectory, reference: Reference, *, walking: bool, stepping: bool) -> None:
        """Start a motion from the posture reference of the last tick; it replaces a running motion without a jump.

        A single point at rest that is due within ``setpoint_time_s`` may belong to a stream of setpoints. It takes this
        time if the previous motion ends within it and the step from that end is at most ``start_jump`` plus the travel
        at the current velocity. Otherwise it takes as long as the limits of planned motions require. An initial
        velocity fades out within ``stop_time_s`` if the motion does not start with it, as for joints that it does not
        name, or if it would exceed the joint limits. A motion that does not end at rest is slowed down like a stopped
        one. While ``walking``, only arms and head follow, blended in and out. While ``stepping``, the gait moves legs
        and torso until the motion ends. Raises ``TrajectoryError`` or ``JointNameError`` as ``validate_trajectory``.
        """
        start, speed = self._start(reference, trajectory)
        if walking:
            self._upper.follow(trajectory, start)
            return
        moving = trajectory.velocities is not None and trajectory.velocities.any()
        if len(trajectory.times) == 1 and not (moving and trajectory.times[0] > 0.0):  # a setpoint, perhaps of a stream
            trajectory = replace(trajectory, times=self._setpoint_times(trajectory, start, speed))
        validate_trajectory(trajectory, self._model, start_q=start)
        if stepping and self._legs is None:
            self._legs = self._last[0]
        self._upper.drop()  # ``start`` contains what is left of a motion of the walk
        self._begin(trajectory, start, speed)

    def stop(self, reference: Reference) -> None:
        """Slow down within ``stop_time_s``, and hold the posture reached."""
        self._upper.stop()
        if self._motion is None:
            return
        self._slow_down(*self._start(reference, None))

    def stand_up(self) -> None:
        """End any motion and move from the current posture to 'stand', which the arms hold during a walk."""
        self._upper.release()
        if self._motion is None and np.array_equal(self._last[0], self._stand):
            return
        self._begin(self._trajectory_to(self._stand, self._config.stand_up_s), *self._last)
        self._standing_up = True

    def end_walk(self) -> None:
        """Blend out a motion of arms and head that started while walking."""
        self._upper.stop()

    def hold_legs(self) -> None:
        """Hold legs and torso at the current posture during a motion, since the robot steps."""
        if self._motion is not None:
            self._legs = self._last[0]

    def release_legs(self) -> None:
        """Set the posture of held legs and torso to 'stand', once they follow the gait alone."""
        if self._legs is not None:
            self._legs = self._stand

    def step(self, dt: float) -> tuple[Vector, Vector, Vector]:
        """Posture, velocity and acceleration, ``dt`` [s] after the last tick, each (nj,) [rad, rad/s, rad/s^2]."""
        posture, velocity, acceleration = self._sample(dt)
        self._last = posture, velocity
        posture, velocity, acceleration = self._upper.step(posture, velocity, acceleration, dt)
        if self._head is not None:
            posture, velocity, acceleration = self._head.step(posture, velocity, acceleration, dt)
        return posture, velocity, acceleration

    def _sample(self, dt: float) -> tuple[Vector, Vector, Vector]:
        if self._motion is None:
            return self._hold, self.zero, self.zero
        self._time += dt
        if self._time >= self._motion.duration and self._motion.ends_moving:
            self._slow_down(*self._last)
            self._time = dt
        sample = self._motion.sample(self._time)
        if self._time < self._fade:
            sample = self._with_former(sample)
        if self._legs is not None:
            sample = (
                np.where(self.free, sample[0], self._legs),
                np.where(self.free, sample[1], 0.0),
                np.where(self.free, sample[2], 0.0),
            )
        if self._time >= max(self._motion.duration, self._fade):
            self._hold = sample[0].copy()
            self._motion = self._legs = None
        return sample

    def _start(self, reference: Reference, motion: JointTrajectory | None) -> tuple[Vector, Vector]:
        """Posture (nj,) [rad] and velocity (nj,) [rad/s] from which a motion starts or slows down."""
        if self._head is None:
            return reference.posture, reference.posture_velocity
        return self._head.without_head(reference, motion)

    def _setpoint_times(self, setpoint: JointTrajectory, start: Vector, speed: Vector) -> Vector:
        """Time of a single point (1,) [s]; see ``follow``, also for errors."""
        validate_trajectory(setpoint, self._model)
        config, model = self._config, self._model
        if setpoint.times[0] > config.setpoint_time_s:
            return setpoint.times
        end, left = start, 0.0  # end and remaining time of the motion that it replaces
        if self._motion is not None:
            end, left = self._motion.sample(self._motion.duration)[0], self._motion.duration - self._time
        rest = start + 0.5 * config.setpoint_time_s * speed
        joints = [model.joint_index(name) for name in setpoint.joint_names]
        step, way = (setpoint.positions[0] - q[joints] for q in (end, rest))
        # After a lost or late setpoint, the distance to the next one includes the travel of the joint meanwhile.
        reach = self._limits.start_jump + min(self._time, config.setpoint_time_s) * np.abs(speed[joints])
        if left <= config.setpoint_time_s and (np.abs(step) <= reach).all():
            return np.array([config.setpoint_time_s])
        v_max = self._planned.velocity_fraction * model.v_max[joints]
        return np.array([max(blend_time(way, v_max, self._planned.acceleration), config.setpoint_time_s)])

    def _slow_down(self, start: Vector, speed: Vector) -> None:
        """Come to rest from a posture (nj,) [rad] and its velocity (nj,) [rad/s]."""
        time = self._config.stop_time_s
        end = np.clip(start + 0.5 * time * speed, self._model.q_lower, self._model.q_upper)
        self._begin(self._trajectory_to(end, time), start, speed)

    def _begin(self, trajectory: JointTrajectory, start: Vector, speed: Vector) -> None:
        self._motion = TrajectorySampler(trajectory, self._model, start, speed)
        if speed.any() and not self._stays_inside(self._motion, start):
            self._motion = TrajectorySampler(trajectory, self._model, start)
        self._time, self._standing_up = 0.0, False
        left = speed - self._motion.sample(0.0)[1]
        self._former = np.zeros((3, self._model.nj))
        self._former[1] = np.where(np.abs(left) > STILL, left, 0.0)
        self._fade = self._config.stop_time_s if self._former.any() else 0.0

    def _with_former(self, sample: tuple[Vector, Vector, Vector]) -> tuple[Vector, Vector, Vector]:
        """Add the fading initial velocity to a sample, within the joint limits."""
        offset, velocity, acceleration = fade_out(self._former, self._time, self._fade)
        low = np.minimum(self._model.q_lower - sample[0], 0.0)
        high = np.maximum(self._model.q_upper - sample[0], 0.0)
        free = (offset >= low) & (offset <= high)  # at a limit the joint rests
        return (
            sample[0] + np.clip(offset, low, high),
            np.where(free, sample[1] + velocity, 0.0),
            np.where(free, sample[2] + acceleration, 0.0),
        )

    def _stays_inside(self, motion: TrajectorySampler, start: Vector) -> bool:
        """Whether the segment to the first point, with the initial velocity, keeps the joint limits."""
        if not len(motion.coefficients):
            return True
        q = _POWERS @ motion.coefficients[0]  # (8, nj)
        low, high = np.minimum(self._model.q_lower, start), np.maximum(self._model.q_upper, start)
        tolerance = self._limits.overshoot_tolerance
        return bool(((q > low - tolerance) & (q < high + tolerance)).all())

    def _trajectory_to(self, end: Vector, time: float) -> JointTrajectory:
        """Trajectory to a posture (nj,) [rad] at rest within a time [s]."""
        return JointTrajectory(self._model.joint_names, np.array([time]), end[None], np.zeros((1, self._model.nj)))
