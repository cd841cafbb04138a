"""Pan and tilt of the head, added to the posture reference of the whole-body law."""

import math
from typing import Annotated

import numpy as np
from msgspec.structs import replace
from pydantic import Field
from pydantic.dataclasses import dataclass

from controllers.balance.upper_body import free_joints
from models.config import STRICT, default_config
from models.errors import CommandError, ConfigError
from models.robot_model import RobotModel
from models.types import ControlResult, JointTrajectory, Reference, SolveStatus, Vector

SETTLED = 1e-7  #: Distance from the goal below which the head has reached it [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class HeadConfig:
    """Speed and smoothing of the head; see ``controllers/config/head.yaml``."""

    speed: Annotated[float, Field(gt=0, le=10)]  #: Fastest turn of either joint [rad/s]
    bandwidth: Annotated[float, Field(gt=0, le=100)]  #: Bandwidth of the low-pass filters that smooth the ramp [rad/s]
    limit_margin: Annotated[float, Field(ge=0, le=0.2)]  #: Distance kept from the joints' stops [rad]
    grip_time: Annotated[float, Field(gt=0, le=10)]  #: Time in which the drivers take over the goal [s]


class Head:
    r"""Moves pan and tilt of the head to the commanded angles, with bounded speed and acceleration.

    .. math::
        \dot r = \mathrm{clip}(g - r), \quad \dot x = w (r - x), \quad \dot q = w (x - q)

    The ramp r moves to the goal g with bounded speed, within the joint limits. Two low-pass filters of bandwidth w
    smooth it. They average past values of the ramp, so q keeps the limits of position and speed. The acceleration of q
    is continuous and at most twice the speed times w.

    The QP tracks q with the posture's gains, which leave an error of several degrees under dry friction, since the
    inertia of the joints is small. Therefore the setpoint of the drivers is blended to q, with a weight that goes from
    0 to 1 within ``grip_time``.

    The last command applies until a motion moves the head. ``release`` then reduces the difference to the posture of
    the motion to zero by the same ramp and filters. Before the first command, and when the difference is zero, the
    posture is returned unchanged.

    Raises ``ConfigError`` when the profile has no head, or when a head joint also moves a foot or the torso.
    """

    def __init__(self, model: RobotModel, config: HeadConfig | None = None) -> None:
        self.config = config = config or default_config(HeadConfig, "controllers", "head")
        head = model.profile.head
        if head is None:
            raise ConfigError(f"{model.name}: head: the profile names no joints of pan and tilt")
        self.joints = np.array([model.joint_index(name) for name in (head.pan, head.tilt)])
        for name, free in zip((head.pan, head.tilt), free_joints(model)[self.joints], strict=True):
            if not free:
                raise ConfigError(f"{model.name}: head: joint '{name}' moves a foot or the torso")
        self._names = (head.pan, head.tilt)
        self._low = model.q_lower[self.joints] + config.limit_margin
        self._high = model.q_upper[self.joints] - config.limit_margin
        self._speed = np.minimum(config.speed, model.v_max[self.joints])
        self._stages = np.zeros((3, 2))  # ramp, first and second low-pass, of pan and tilt [rad]
        self._input = np.zeros((2, 2))  # positions [rad] and velocities [rad/s] of both joints in the given posture
        self.discard_command()

    @property
    def active(self) -> bool:
        """Whether ``step`` changes the posture."""
        return self._goal is not None or self._modifies_posture

    @property
    def _modifies_posture(self) -> bool:
        """Whether ``step`` changed the posture in the last tick; otherwise ``_input`` is out of date."""
        return not self._relative or self._drive_weight > 0.0 or bool(self._stages.any())

    def discard_command(self) -> None:
        """Discard the goal and the filter state, so that the posture is returned unchanged."""
        self._goal: Vector | None = None
        self._relative = True  # whether the stages are relative to the posture, or absolute
        self._stages[:] = self._drive_weight = 0.0

    def command(self, pan: float, tilt: float) -> None:
        """Set the goal to joint angles [rad], clipped to the limits; ``CommandError`` when one is not finite."""
        for name, value in (("pan", pan), ("tilt", tilt)):
            if not math.isfinite(value):
                raise CommandError(f"{name}: {value} rad is not finite")
        self._goal = np.clip([pan, tilt], self._low, self._high)

    def release(self, motion: JointTrajectory) -> None:
        """End the command when a motion names a joint of the head."""
        if not any(name in motion.joint_names for name in self._names):
            return
        self._goal = None
        if self._modifies_posture and self._relative:
            # The head is returning to the posture of an earlier motion, which may be far from the new one.
            self._stages += self._origin()
            self._relative = False

    def step(self, posture: Vector, velocity: Vector, acceleration: Vector, dt: float) -> tuple[Vector, Vector, Vector]:
        """Posture, velocity and acceleration with the head, ``dt`` [s] later; the given arrays when unchanged."""
        if not self.active:
            return posture, velocity, acceleration
        stages, joints, w = self._stages, self.joints, self.config.bandwidth
        position, rate = self._input
        position[:], rate[:] = posture[joints], velocity[joints]
        weight_goal = 0.0 if self._goal is None else 1.0
        self._drive_weight += min(
            max(weight_goal - self._drive_weight, -dt / self.config.grip_time), dt / self.config.grip_time
        )
        if self._relative is not (self._goal is None):
            # Change the origin to its value of the last tick, so that position and velocity are continuous.
            origin = self._origin() - rate * dt
            stages += -origin if self._goal is None else origin
            self._relative = self._goal is None
        goal = np.zeros(2) if self._goal is None else self._goal
        resting = bool((stages == goal).all())
        if not resting:
            share = 1.0 - math.exp(-w * dt)
            stages[0] += np.clip(goal - stages[0], -self._speed * dt, self._speed * dt)
            stages[1] += share * (stages[0] - stages[1])
            stages[2] += share * (stages[1] - stages[2])
            if (np.abs(stages - goal) < SETTLED).all():
                stages[:] = goal
        posture = posture.copy()
        posture[joints] = stages[2]
        if self._relative:
            posture[joints] += position
        if resting and not rate.any():
            return posture, velocity, acceleration
        velocity, acceleration = velocity.copy(), acceleration.copy()
        if not self._relative:
            velocity[joints], acceleration[joints] = 0.0, 0.0
        velocity[joints] += w * (stages[1] - stages[2])
        acceleration[joints] += w**2 * (stages[0] - 2.0 * stages[1] + stages[2])
        return posture, velocity, acceleration

    def blend_setpoint(self, result: ControlResult, reference: Reference) -> ControlResult:
        """Blend the head joints of the drivers' setpoint to the reference."""
        if not self._drive_weight or result.status is SolveStatus.DAMPED:
            return result
        command, joints = result.command, self.joints
        q, v = command.q.copy(), command.v.copy()
        q[joints] += self._drive_weight * (reference.posture[joints] - q[joints])
        v[joints] += self._drive_weight * (reference.posture_velocity[joints] - v[joints])
        return replace(result, command=replace(command, q=q, v=v))

    def without_head(self, reference: Reference, motion: JointTrajectory | None = None) -> tuple[Vector, Vector]:
        """Start of a motion: posture (nj,) [rad] and its rate [rad/s] without the motion of the head.

        Head joints that the optional ``motion`` moves start at its first point, so it may be planned with or without
        the motion of the head. ``step`` reduces the difference to zero.
        """
        if not self._modifies_posture:
            return reference.posture, reference.posture_velocity
        posture, velocity = reference.posture.copy(), reference.posture_velocity.copy()
        posture[self.joints], velocity[self.joints] = self._input
        names = () if motion is None else motion.joint_names
        if motion is not None and len(motion.positions) and motion.positions.shape[1:] == (len(names),):
            for joint, name in zip(self.joints, self._names, strict=True):
                if name in names:
                    posture[joint] = motion.positions[0, names.index(name)]
        return posture, velocity

    def _origin(self) -> Vector:
        """Stages (3, 2) [rad] in steady state for the given posture and its rate."""
        position, rate = self._input
        return np.array(position + np.array([[2.0], [1.0], [0.0]]) * rate / self.config.bandwidth)
