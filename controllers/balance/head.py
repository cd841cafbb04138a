"""Pan and tilt of the head, on top of whatever posture the law in charge wants."""

from __future__ import annotations

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

SETTLED = 1e-7  #: A head that is so near to its goal has reached it [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class HeadConfig:
    """How the head goes to where it is sent; see ``controllers/config/head.yaml``."""

    speed: Annotated[float, Field(gt=0, le=10, description="Fastest turn of either joint [rad/s]")]
    bandwidth: Annotated[float, Field(gt=0, le=100, description="Of the low-passes that round the ramp [rad/s]")]
    limit_margin: Annotated[float, Field(ge=0, le=0.2, description="Distance kept from the joints' stops [rad]")]
    grip_time: Annotated[float, Field(gt=0, le=10, description="Until the drivers hold the head where it is sent [s]")]


class Head:
    r"""Moves two joints of a posture to where they are sent, smoothly whatever is commanded.

    .. math::
        \dot r = \mathrm{clip}(g - r), \quad \dot x = w (r - x), \quad \dot q = w (x - q)

    A ramp r of bounded speed goes to the goal g within the joints' limits; two low-passes of bandwidth w round it. Both
    are averages of what the ramp was, so q keeps the limits of position and speed, and its acceleration, at most twice
    the speed times w, has no step.

    The QP tracks q with the posture's gains, which dry friction beats by several degrees in a joint with so little
    inertia; so the drivers are told q, too, with a weight that goes from 0 to 1 within ``grip_time``.

    Between two commands the last one counts. A motion that moves the head has it from then on: ``release`` leads the
    difference to the motion's posture back to zero in the same way. Untouched until the first command, and again once
    that difference is gone, the posture is passed on as it is.

    Args:
        model: The robot; its profile names the joints.
        config: Limits; the packaged ones when None.

    Raises:
        ConfigError: The profile names no head, or a joint that also moves a foot or the torso.
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
        self._under = np.zeros((2, 2))  # what the posture itself wants: positions, velocities
        self.drop()

    @classmethod
    def of(cls, model: RobotModel, config: HeadConfig | None = None) -> Head | None:
        """The head of a robot that has one."""
        return None if model.profile.head is None else cls(model, config)

    @property
    def active(self) -> bool:
        """Whether it changes the posture."""
        return self._goal is not None or self._felt

    @property
    def _felt(self) -> bool:
        """Whether it changed the posture on the last tick: only then is it known what was below."""
        return not self._relative or self._grip > 0.0 or bool(self._stages.any())

    def drop(self) -> None:
        """Forget everything: the posture is passed on as it is."""
        self._goal: Vector | None = None
        self._relative = True  # whether the stages are counted from the posture, or from zero
        self._stages[:] = self._grip = 0.0

    def command(self, pan: float, tilt: float) -> None:
        """Send the head to joint angles [rad], brought within the limits.

        Raises:
            CommandError: A value is not finite; names it.
        """
        for name, value in (("pan", pan), ("tilt", tilt)):
            if not math.isfinite(value):
                raise CommandError(f"{name}: {value} rad is no angle")
        self._goal = np.clip([pan, tilt], self._low, self._high)

    def release(self, motion: JointTrajectory) -> None:
        """Leave the head to a motion, if that names one of its joints."""
        if not any(name in motion.joint_names for name in self._names):
            return
        self._goal = None
        if self._felt and self._relative:
            # It is on the way to what another motion wants: what this one wants may be far from that.
            self._stages += self._origin()
            self._relative = False

    def step(self, posture: Vector, velocity: Vector, acceleration: Vector, dt: float) -> tuple[Vector, Vector, Vector]:
        """A posture with the head in it, a tick of so many seconds later.

        Args:
            posture: What the law wants (nj,) [rad].
            velocity: Its rate (nj,) [rad/s].
            acceleration: And the rate of that (nj,) [rad/s^2].
            dt: Length of the tick [s].

        Returns:
            The three; the given velocity itself while neither the head nor the posture below it moves.
        """
        if not self.active:
            return posture, velocity, acceleration
        stages, joints, w = self._stages, self.joints, self.config.bandwidth
        under, rate = self._under
        under[:], rate[:] = posture[joints], velocity[joints]
        wanted = 0.0 if self._goal is None else 1.0
        self._grip += min(max(wanted - self._grip, -dt / self.config.grip_time), dt / self.config.grip_time)
        if self._relative is not (self._goal is None):
            # Count from the other origin, as it was a tick ago, so that position and velocity go on.
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
            posture[joints] += under
        if resting and not rate.any():
            return posture, velocity, acceleration
        velocity, acceleration = velocity.copy(), acceleration.copy()
        if not self._relative:
            velocity[joints], acceleration[joints] = 0.0, 0.0
        velocity[joints] += w * (stages[1] - stages[2])
        acceleration[joints] += w**2 * (stages[0] - 2.0 * stages[1] + stages[2])
        return posture, velocity, acceleration

    def into(self, reference: Reference, dt: float) -> Reference:
        """A reference with the head in its posture, a tick of so many seconds later."""
        if not self.active:
            return reference
        posture, velocity, acceleration = self.step(
            reference.posture, reference.posture_velocity, reference.posture_acceleration, dt
        )
        return replace(reference, posture=posture, posture_velocity=velocity, posture_acceleration=acceleration)

    def drive(self, result: ControlResult, reference: Reference) -> ControlResult:
        """The answer to a reference with the head in it: the drivers hold the head where that has it."""
        if not self._grip or result.status is SolveStatus.DAMPED:
            return result
        command, joints = result.command, self.joints
        q, v = command.q.copy(), command.v.copy()
        q[joints] += self._grip * (reference.posture[joints] - q[joints])
        v[joints] += self._grip * (reference.posture_velocity[joints] - v[joints])
        return replace(result, command=replace(command, q=q, v=v))

    def without(self, reference: Reference, motion: JointTrajectory | None = None) -> tuple[Vector, Vector]:
        """Posture (nj,) [rad] and its rate (nj,) [rad/s] below the head: where motions are planned from and start.

        Args:
            reference: Of the last tick, with the head in it.
            motion: About to start. Where it moves the head, that starts where the motion has it: it was made from where
                the head is or from the posture below it, and either way ``step`` leads the head over.
        """
        if not self._felt:
            return reference.posture, reference.posture_velocity
        posture, velocity = reference.posture.copy(), reference.posture_velocity.copy()
        posture[self.joints], velocity[self.joints] = self._under
        names = () if motion is None else motion.joint_names
        if motion is not None and len(motion.positions) and motion.positions.shape[1:] == (len(names),):
            for joint, name in zip(self.joints, self._names, strict=True):
                if name in names:
                    posture[joint] = motion.positions[0, names.index(name)]
        return posture, velocity

    def _origin(self) -> Vector:
        """Stages of a head that follows the posture below alone, as that goes on by its rate (3, 2) [rad]."""
        under, rate = self._under
        return np.array(under + np.array([[2.0], [1.0], [0.0]]) * rate / self.config.bandwidth)
