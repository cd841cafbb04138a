"""The gait: when which foot lifts and lands, and what the whole body is to track meanwhile."""

from __future__ import annotations

import math
from enum import Enum

import numpy as np

from models.constants import GRAVITY
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import Reference, RobotState, Vector
from planners.gait import dcm
from planners.gait.config import GaitConfig, load_gait_config
from planners.gait.footsteps import Foothold, wrap
from planners.gait.measurement import GaitMeasurement
from planners.gait.plan import StepPlan
from planners.gait.reference import ReferenceBuilder
from planners.gait.swing import SwingFoot
from planners.gait.velocity import VelocityLimiter


class GaitPhase(Enum):
    """Phase of the gait."""

    STAND = "stand"
    START = "start"
    """Both feet; the weight moves to the first stance foot."""
    SINGLE = "single"
    DOUBLE = "double"
    """Both feet; the weight moves to the foot that has just landed."""
    FINISH = "finish"
    """Both feet; the weight returns to the middle."""


class GaitPlanner:
    """Walks at a commanded velocity and stands still when none is commanded.

        stand -> start -> single <-> double -> finish -> stand

    Single supports end with the measured contact, or later with it: time alone never puts a foot down. Their touchdown
    time and foothold are adjusted every few ticks (``step_adjustment.py``) from the measured DCM. In every phase the
    DCM reference is the closed form that ends where the coming steps need it (``dcm.py``).

    Args:
        model: The robot.
        config: The gait; that of the robot when None.

    Attributes:
        phase: Phase now.
        footholds: Planted pose of each sole, or the target of the one that swings.
        stance: The foot that bears in single support, or that will.
        steps: Touchdowns so far.
        step_time: Planned single support of the step under way [s].
    """

    def __init__(self, model: RobotModel, config: GaitConfig | None = None) -> None:
        self.model = model
        self.config = config = config or load_gait_config(model)
        self._measured = GaitMeasurement(model)
        self._limiter = VelocityLimiter(config.velocity)
        self._plan = StepPlan(model, config)
        self._swing = SwingFoot(config.swing)
        self._builder = ReferenceBuilder(model, config)
        self.footholds = [Foothold(0.0, 0.0, 0.0), Foothold(0.0, 0.0, 0.0)]
        self.phase = GaitPhase.STAND
        self.stance = 1
        self.steps = 0
        self.step_time = config.timing.single
        self._elapsed = 0.0
        self._settled = 0.0
        self._steps_left: int | None = None
        self._dcm, self._dcm_rate = np.zeros(2), np.zeros(2)
        self._from = (np.zeros(2), np.zeros(2))
        self._old_point = np.zeros(2)
        self._target = np.zeros(2)
        self._next_adjustment = 0.0
        self._early = 0.0

    @property
    def walking(self) -> bool:
        """Whether steps are being taken, or the weight is on its way back to the middle."""
        return self.phase is not GaitPhase.STAND

    @property
    def settled(self) -> bool:
        """Whether the robot has stood still for ``settle_time``."""
        return self.phase is GaitPhase.STAND and self._settled >= self.config.settle_time

    def reset(self, state: RobotState) -> None:
        """Start over from a robot that stands on both feet."""
        measured = self._measured
        measured.update(state)
        self.footholds = list(measured.soles)
        self._limiter.reset()
        self._builder.reset(measured.com[2] - self._ground())
        self._dcm[:] = measured.com[:2]
        self._dcm_rate[:] = 0.0
        self._steps_left = None
        self._enter(GaitPhase.STAND)
        self.steps = 0
        self._from = (self._dcm.copy(), np.zeros(2))

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Wanted velocity of the body in its own frame [m/s, m/s, rad/s]; brought into the limits. Zero stands still.

        Raises:
            CommandError: A value is not finite.
        """
        if not all(math.isfinite(value) for value in (forward, left, turn)):
            raise CommandError(f"velocity ({forward}, {left}, {turn}) refused: not finite")
        self._limiter.set(forward, left, turn)

    def stop(self) -> None:
        """Come to a standstill within two steps."""
        self._limiter.set(0.0, 0.0, 0.0)

    def step(self, state: RobotState, dt: float) -> Reference:
        """One tick.

        Args:
            state: Estimated state.
            dt: Time since the last tick [s].

        Returns:
            What the whole-body controller is to track.
        """
        self._measured.update(state)
        self._elapsed += dt
        self._follow_soles(dt)
        self._heed_command(dt)
        getattr(self, f"_in_{self.phase.value}")(dt)
        return self._builder.build(
            self.footholds,
            self._swing if self.phase is GaitPhase.SINGLE else None,
            1 - self.stance,
            self._loads(),
            self._dcm,
            self._dcm_rate,
            upright=self.phase in (GaitPhase.STAND, GaitPhase.FINISH),
            dt=dt,
        )

    # Phases -----------------------------------------------------------------------------------------------------------

    def _in_stand(self, dt: float) -> None:
        middle = self._middle()
        self._dcm, self._dcm_rate = dcm.blend(
            self._from, (middle, np.zeros(2)), self._elapsed, self.config.timing.finish
        )
        near = float(np.linalg.norm(self._measured.dcm(self._omega()) - middle)) < self.config.settle_dcm
        self._settled = self._settled + dt if near else 0.0
        if self._must_step():
            self._recover()
        elif self._limiter.moving:
            self._begin()

    def _in_start(self, dt: float) -> None:
        duration = self.config.timing.start
        end = self._sync().start_of_single()
        rate = self._omega() * (end - self._point(self.stance))
        self._dcm, self._dcm_rate = dcm.blend(self._from, (end, rate), self._elapsed, duration)
        if self._elapsed >= duration:
            self._lift()

    def _in_double(self, dt: float) -> None:
        duration, omega = self.config.timing.double, self._omega()
        new, end = self._point(self.stance), self._sync().start_of_single()
        elapsed = self._elapsed - self._early
        dcm_now = dcm.double_support(self._old_point, new, end, omega, max(elapsed, 0.0), duration)
        if elapsed < 0.0:
            # Landed early: the pendulum still runs to where it was to be at the planned touchdown.
            dcm_now = dcm.single_support(self._old_point, dcm_now[0], omega, -elapsed)
        self._dcm, self._dcm_rate = dcm_now
        if elapsed >= duration:
            self._lift()

    def _in_finish(self, dt: float) -> None:
        duration = self.config.timing.finish
        self._dcm, self._dcm_rate = dcm.blend(self._from, (self._middle(), np.zeros(2)), self._elapsed, duration)
        if self._must_step():
            self._recover()
        elif self._elapsed >= duration:
            self._enter(GaitPhase.STAND)

    def _in_single(self, dt: float) -> None:
        config, foot = self.config, 1 - self.stance
        left = self.step_time - self._elapsed
        if self._elapsed >= self._next_adjustment and left > config.swing.freeze:
            self._adjust()
            self._next_adjustment = self._elapsed + config.timing.adjust_period
        target = self.footholds[foot]
        yaw = float(self._swing.position[3])
        pose = np.array([target.x, target.y, self.footholds[self.stance].z, yaw + wrap(target.yaw - yaw)])
        self._swing.step(pose, self._elapsed, self.step_time, dt)
        self._dcm, self._dcm_rate = dcm.single_support(
            self._point(self.stance), self._target, self._omega(), max(self.step_time - self._elapsed, 0.0)
        )
        if self._measured.active[foot] and self._elapsed > config.timing.landing_from * self.step_time:
            self._land(foot)

    # Events -----------------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """From standing: choose the first swing foot, the one on the side of the command."""
        _, left, turn = self._limiter.wanted
        lean = left if abs(left) > 1e-6 else turn
        self.stance = 1 if lean >= 0.0 else 0
        self._from = (self._dcm.copy(), self._dcm_rate.copy())
        self._steps_left = None
        self._enter(GaitPhase.START)

    def _recover(self) -> None:
        """A step at once, without a shift of the weight: the foot away from the DCM swings."""
        near = [float(np.linalg.norm(self._measured.dcm(self._omega()) - self._point(foot))) for foot in range(2)]
        self.stance = 0 if near[0] < near[1] else 1
        self._steps_left = 2
        self._lift()

    def _lift(self) -> None:
        foot = 1 - self.stance
        sole = self._measured.soles[foot]
        self._swing.lift(np.array([sole.x, sole.y, sole.z, sole.yaw]))
        self.step_time = self.config.timing.single
        self._next_adjustment = 0.0
        self._enter(GaitPhase.SINGLE)
        self._adjust()

    def _land(self, foot: int) -> None:
        self.steps += 1
        self._old_point = self._point(self.stance)
        self._early = max(self.step_time - self._elapsed, 0.0)
        self.footholds[foot] = self._measured.soles[foot]
        self.stance = foot
        if self._steps_left is not None:
            self._steps_left -= 1
        if self._steps_left is not None and self._steps_left <= 0 and self._must_step():
            self._steps_left = 1  # not caught yet
        if self._steps_left is not None and self._steps_left <= 0:
            self._from = (self._dcm.copy(), self._dcm_rate.copy())
            self._steps_left = None
            self._enter(GaitPhase.FINISH)
        else:
            self._enter(GaitPhase.DOUBLE)

    def _enter(self, phase: GaitPhase) -> None:
        self.phase = phase
        self._elapsed = 0.0
        self._settled = 0.0
        if phase is GaitPhase.STAND:
            self._from = (self._dcm.copy(), self._dcm_rate.copy())

    def _heed_command(self, dt: float) -> None:
        """Advance the velocity; count down the last two steps once none is wanted."""
        walking = self.phase in (GaitPhase.START, GaitPhase.SINGLE, GaitPhase.DOUBLE)
        if self._limiter.moving:
            self._limiter.step(dt)
            self._steps_left = None
        elif walking and self._steps_left is None:
            self._steps_left = 2
        elif not walking:
            self._limiter.reset()

    def _sync(self) -> StepPlan:
        """The step plan, told where the gait is."""
        plan = self._plan
        plan.stance, plan.foot = self.footholds[self.stance], 1 - self.stance
        plan.velocity, plan.steps_left = self._limiter.velocity, self._steps_left
        plan.omega = self._omega()
        return plan

    def _adjust(self) -> None:
        """Foothold and time of the step under way, from the measured DCM."""
        plan = self._sync()
        self.footholds[plan.foot], self.step_time, self._target = plan.adjust(
            self._measured.dcm(plan.omega), self._elapsed, self.step_time, self._swing.position
        )

    # Small things -----------------------------------------------------------------------------------------------------

    def _omega(self) -> float:
        return math.sqrt(GRAVITY / max(self._builder.height, 0.1))

    def _point(self, foot: int) -> Vector:
        """ZMP point of a planted foot: the middle of its sole (2,)."""
        return self._plan.point(foot, self.footholds[foot])

    def _middle(self) -> Vector:
        middle: Vector = 0.5 * (self._point(0) + self._point(1))
        return middle

    def _must_step(self) -> bool:
        """Whether the DCM nears the edge of the box around both soles, so that standing cannot bring it back."""
        left, right = self.footholds
        x, y = (float(value) for value in self._middle())
        frame = Foothold(x, y, left.yaw + 0.5 * wrap(right.yaw - left.yaw))
        dcm_now = frame.relative(*self._measured.dcm(self._omega()))
        apart = frame.relative(*self._point(0))
        half = self._plan.half_sole(0)
        share = self.config.step_share
        return any(abs(dcm_now[i]) > share * (float(half[i]) + abs(apart[i])) for i in range(2))

    def _ground(self) -> float:
        return 0.5 * (self.footholds[0].z + self.footholds[1].z)

    def _loads(self) -> tuple[float, float]:
        """Share of the weight that each foot is to bear, from where the reference's ZMP lies between them."""
        if self.phase is GaitPhase.STAND:
            return 1.0, 1.0
        if self.phase is GaitPhase.SINGLE:
            return (1.0, 0.0) if self.stance == 0 else (0.0, 1.0)
        left, right = self._point(0), self._point(1)
        way = right - left
        zmp = self._dcm - self._dcm_rate / self._omega()
        share = float(np.clip((zmp - left) @ way / (way @ way), 0.0, 1.0))
        return 1.0 - share, share

    def _follow_soles(self, dt: float) -> None:
        """Planted footholds creep after the soles that bear: what the estimator cannot observe moves both alike."""
        share = min(dt / self.config.anchor_time, 1.0)
        for foot in range(2):
            if self.phase is GaitPhase.SINGLE and foot != self.stance:
                continue
            if self._measured.loads[foot] < self.config.anchor_load:
                continue
            hold, sole = self.footholds[foot], self._measured.soles[foot]
            self.footholds[foot] = Foothold(
                hold.x + share * (sole.x - hold.x),
                hold.y + share * (sole.y - hold.y),
                hold.yaw + share * wrap(sole.yaw - hold.yaw),
                hold.z + share * (sole.z - hold.z),
            )
