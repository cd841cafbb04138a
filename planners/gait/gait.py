"""The gait: when which foot lifts and lands, and what the whole body is to track meanwhile."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from models.constants import GRAVITY
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import Reference, RobotState, Vector
from planners.gait.config import GaitConfig, load_gait_config
from planners.gait.dcm_reference import DcmReference
from planners.gait.footstep_plan import Footstep
from planners.gait.footsteps import Foothold, clamped, wrap
from planners.gait.leg_lever import leg_lever
from planners.gait.lifted import Lifted
from planners.gait.measurement import GaitMeasurement
from planners.gait.plan import StepPlan
from planners.gait.reaction import SwingReaction
from planners.gait.reference import ReferenceBuilder
from planners.gait.route import Route
from planners.gait.soles import Soles, moved
from planners.gait.swing import SwingFoot
from planners.gait.velocity import VelocityLimiter
from planners.gait.view import GaitView


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
    LIFTED = "lifted"
    """In the air: nothing moves."""


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
        route: Footsteps that are being taken instead of a velocity's.
    """

    def __init__(self, model: RobotModel, config: GaitConfig | None = None) -> None:
        self.model = model
        self.config = config = config or load_gait_config(model)
        self._measured = GaitMeasurement(model)
        self._limiter = VelocityLimiter(config.velocity)
        self._reaction = reaction = SwingReaction(leg_lever(model))
        self._swing = SwingFoot(config.swing)
        self._soles = Soles(model, config)
        self.route = Route(config)
        self._plan = StepPlan(self._soles, config, reaction, self._swing, self.route)
        self._dcm = DcmReference(reaction)
        self._builder = ReferenceBuilder(model, config, reaction)
        self._lifted_off = Lifted(model, config.lift)
        self._muted = False
        self.phase = GaitPhase.STAND
        self.stance = 1
        self.steps = 0
        self.step_time = config.timing.single
        self._elapsed = 0.0
        self._settled = 0.0
        self._steps_left: int | None = None
        self._lifted = Foothold(0.0, 0.0, 0.0)
        self._target = np.zeros(2)
        self._next_adjustment = 0.0
        self._early = 0.0
        self._caught = False

    @property
    def footholds(self) -> list[Foothold]:
        """Planned pose of each sole, or the target of the one that swings."""
        return self._soles.holds

    @property
    def trips(self) -> int:
        """How often a swing foot was caught by something so far."""
        return self._swing.trips

    @property
    def walking(self) -> bool:
        """Whether steps are being taken, or the weight is on its way back to the middle."""
        return self.phase is not GaitPhase.STAND

    @property
    def settled(self) -> bool:
        """Whether the robot has stood still for ``settle_time``."""
        return self.phase is GaitPhase.STAND and self._settled >= self.config.settle_time

    @property
    def view(self) -> GaitView:
        """Where the gait is, for those who watch it."""
        return GaitView(
            phase=self.phase.value,
            swinging=self.phase is GaitPhase.SINGLE,
            stance=self.stance,
            steps=self.steps,
            elapsed=self._elapsed,
            step_time=self.step_time,
            steps_left=self._steps_left,
            velocity=self._limiter.velocity,
            dcm=self._measured.dcm(self._omega()),
            omega=self._omega(),
            soles=self._soles,
            unsolved=self._plan.unsolved,
            route=self.route,
        )

    def reset(self, state: RobotState) -> None:
        """Start over from a robot that stands on both feet."""
        measured = self._measured
        measured.update(state)
        self._soles.reset(measured)
        self._limiter.reset()
        self.route.end("the walk began anew")
        self._builder.reset(measured.com[2] - self._soles.ground())
        self._dcm.reset(measured.com[:2])
        self._steps_left = None
        self._lifted_off.reset()
        self._muted = False
        self._enter(GaitPhase.STAND)
        self.steps = 0

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Wanted velocity of the body in its own frame [m/s, m/s, rad/s]; brought into the limits.

        Zero stands still, but leaves a route alone; any other velocity ends it. One that was commanded when the
        robot was lifted counts for nothing until it has been zero.

        Raises:
            CommandError: A value is not finite.
        """
        if not all(math.isfinite(value) for value in (forward, left, turn)):
            raise CommandError(f"velocity ({forward}, {left}, {turn}) refused: not finite")
        self._muted = self._muted and any((forward, left, turn))
        if self._muted:
            return
        self._limiter.set(forward, left, turn)
        if self._limiter.moving:
            self._leave_route("a velocity was commanded")

    def stop(self) -> None:
        """Come to a standstill within two steps."""
        self._limiter.set(0.0, 0.0, 0.0)
        self._leave_route("stopped")

    def walk_to(self, goal: Foothold) -> None:
        """Walk to a pose of the middle between the soles, in W, and stand there; see ``plan_to_pose`` for refusals."""
        foot, under_way = None, None
        if self.phase is GaitPhase.SINGLE:
            foot, under_way = self.stance, Footstep(1 - self.stance, self.footholds[1 - self.stance])
        elif self.phase in (GaitPhase.START, GaitPhase.DOUBLE):
            foot = 1 - self.stance
        self.route.towards(goal, self.footholds, foot, under_way)
        self._limiter.reset()

    def take_steps(self, steps: Sequence[Footstep]) -> None:
        """Take footsteps, from standing, and stand there; see ``check_footsteps`` for further refusals.

        Raises:
            CommandError: The robot is walking.
        """
        if self.walking:
            raise CommandError("footsteps refused: they start from where the robot stands, and it is walking; stop it")
        self.route.take(steps, self.footholds)
        self._limiter.reset()

    def step(self, state: RobotState, dt: float) -> Reference:
        """One tick.

        Args:
            state: Estimated state.
            dt: Time since the last tick [s].

        Returns:
            What the whole-body controller is to track.
        """
        self._measured.update(state)
        if self._hangs(state, dt):
            return self._lifted_off.reference(state, self._measured.com, self._measured.soles)
        self._reaction.com, self._reaction.com_velocity = self._measured.com[:2], self._measured.com_velocity[:2]
        self._elapsed += dt
        swinging = 1 - self.stance if self.phase is GaitPhase.SINGLE else None
        landed = self.stance if self.phase is GaitPhase.DOUBLE else None
        self._carry(self._soles.drift(self._measured, swinging))
        self._soles.follow(self._measured, swinging, landed, dt)
        self._heed_command(dt)
        getattr(self, f"_in_{self.phase.value}")(dt)
        return self._builder.build(
            self.footholds,
            self._soles.tilts,
            self._swing if self.phase is GaitPhase.SINGLE else None,
            1 - self.stance,
            self._loads(),
            self._measured.com,
            self.config.lean_urgent if self._plan.urgent else 0.5,
            self._dcm.dcm,
            self._dcm.rate,
            upright=self.phase in (GaitPhase.STAND, GaitPhase.FINISH),
            dt=dt,
        )

    # Phases -----------------------------------------------------------------------------------------------------------

    def _in_stand(self, dt: float) -> None:
        middle = self._soles.middle()
        self._dcm.blend(middle, np.zeros(2), self._elapsed, self.config.timing.finish)
        near = float(np.linalg.norm(self._measured.dcm(self._omega()) - middle)) < self.config.settle_dcm
        self._settled = self._settled + dt if near else 0.0
        if self._must_step():
            self._recover()
        elif self._limiter.moving or self.route.left:
            self._begin()

    def _in_start(self, dt: float) -> None:
        duration = self.config.timing.start
        end = self._sync().start_of_single()
        rate = self._omega() * (end - self._soles.point(self.stance))
        self._dcm.blend(end, rate, self._elapsed, duration)
        if self._elapsed >= duration:
            self._lift()

    def _in_double(self, dt: float) -> None:
        duration, omega = self.config.timing.double, self._omega()
        new, end = self._soles.point(self.stance), self._sync().start_of_single()
        elapsed = self._elapsed - self._early
        self._dcm.double(new, end, omega, elapsed, duration)
        if elapsed >= duration or self._urgent():
            self._lift()

    def _in_finish(self, dt: float) -> None:
        duration = self.config.timing.finish
        self._dcm.blend(self._soles.middle(), np.zeros(2), self._elapsed, duration)
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
        elif left < 0.0:
            self._shift(foot)
        target, sole = self.footholds[foot], self._measured.soles[foot]
        yaw = float(self._swing.position[3])
        height = self._soles.landing_height(foot, self._measured)
        pose = np.array([target.x, target.y, height, yaw + wrap(target.yaw - yaw)])
        if not self._plan.urgent:  # a foot in a hurry lags as if it were caught
            self._swing.heed(sole.x, sole.y, self._elapsed, self.step_time, dt)
        # A foot in a hurry lags behind its reference, and one that lands late is worse than one that lands early.
        lead = config.swing.urgent_lead if self._plan.urgent else 0.0
        self._swing.step(pose, self._soles.slope, self._elapsed, self.step_time - lead, dt)
        self._dcm.single(
            self._soles.point(self.stance),
            self._target,
            self._swing,
            target,
            self._omega(),
            self.step_time - self._elapsed,
        )
        if self._measured.active[foot] and self._elapsed > config.timing.landing_from * self.step_time:
            self._land(foot)

    def _hangs(self, state: RobotState, dt: float) -> bool:
        """Whether the robot is in the air; put down, it stands where it is and waits for a new command."""
        lifted, (left, right) = self._lifted_off, self._measured.active
        if lifted.update((left, right), state, dt):
            steps = self.steps
            self.reset(state)
            self.steps, self._muted = steps, True
        elif lifted.confirmed and self.phase is not GaitPhase.LIFTED:
            self._limiter.reset()
            self._leave_route("the robot was lifted")
            self._enter(GaitPhase.LIFTED)
            self._muted = True
        # Quick, wide steps leave the floor for some ticks: holding the robot then would be its fall.
        return lifted.active and (lifted.confirmed or not self._plan.urgent)

    # Events -----------------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """From standing: choose the first swing foot, the one on the side of the command."""
        _, left, turn = self._limiter.wanted
        lean = left if abs(left) > 1e-6 else turn
        self.stance = 1 if lean >= 0.0 else 0
        if self.route.left:
            self.stance = 1 - self.route.foot
        self._dcm.begin_blend()
        self._steps_left = None
        self._enter(GaitPhase.START)

    def _recover(self) -> None:
        """A step at once, without a shift of the weight: the foot away from the DCM swings."""
        near = [float(np.linalg.norm(self._measured.dcm(self._omega()) - self._soles.point(foot))) for foot in range(2)]
        self.stance = 0 if near[0] < near[1] else 1
        self._steps_left = 2
        self._caught = True
        self._lift()

    def _lift(self) -> None:
        foot = 1 - self.stance
        self._lifted = sole = self._measured.soles[foot]
        self.step_time = self.config.timing.single
        self._swing.lift(np.array([sole.x, sole.y, sole.z, sole.yaw]), self.step_time, self._soles.tilts[foot])
        self._next_adjustment = 0.0
        self._plan.urgent = self._urgent()
        self._enter(GaitPhase.SINGLE)
        self.footholds[foot] = self._sync().nominal()[0]
        self._adjust()

    def _land(self, foot: int) -> None:
        self.steps += 1
        self._early = max(self.step_time - self._elapsed, 0.0)
        self._soles.land(foot, self._measured)
        self.stance = foot
        if self.route.left:
            self.route.landed(self.footholds)
            self._steps_left = self.route.left + 1
        if self._steps_left is not None:
            self._steps_left -= 1
        astride = self._caught and self._soles.astride()
        if self._steps_left is not None and self._steps_left <= 0 and (self._must_step() or astride):
            self._steps_left = 1  # not caught yet, or in no stance to stay in
        if self._steps_left is not None and self._steps_left <= 0:
            self._dcm.begin_blend()
            self._steps_left = None
            self._enter(GaitPhase.FINISH)
        else:
            self._enter(GaitPhase.DOUBLE)

    def _enter(self, phase: GaitPhase) -> None:
        self.phase = phase
        self._elapsed = 0.0
        self._settled = 0.0
        if phase is GaitPhase.STAND:
            self._plan.urgent = self._caught = False
            self._dcm.begin_blend()

    def _heed_command(self, dt: float) -> None:
        """Advance the velocity; count down the last two steps once none is wanted."""
        walking = self.phase in (GaitPhase.START, GaitPhase.SINGLE, GaitPhase.DOUBLE)
        if self.route.left:
            self._steps_left = self.route.left if self.route.left <= self.config.preview else None
        elif self._limiter.moving:
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
        plan.lifted = self._lifted if self.phase is GaitPhase.SINGLE else self.footholds[plan.foot]
        plan.velocity, plan.steps_left = self._limiter.velocity, self._steps_left
        plan.omega = self._omega()
        return plan

    def _adjust(self) -> None:
        """Foothold and time of the step under way, from the measured DCM."""
        plan = self._sync()
        plan.urgent = plan.urgent or self._urgent()
        self.footholds[plan.foot], self.step_time, self._target = plan.adjust(
            self._measured.dcm(plan.omega), self._elapsed, self.step_time, self.footholds[plan.foot]
        )

    def _leave_route(self, reason: str) -> None:
        if self.route.left:
            self.route.end(reason)
            self._steps_left = None

    def _shift(self, foot: int) -> None:
        """A late foot goes on with the DCM, so that it lands where it was to be under it."""
        target, run = self.footholds[foot], self._measured.dcm(self._omega()) - self._target
        reach = self.config.reach
        if self._plan.urgent:
            reach = replace(reach, width_max=reach.width_urgent)
        moved = clamped(self.footholds[self.stance], foot, target.x + run[0], target.y + run[1], target.yaw, reach)
        self._target = self._target + np.array([moved.x - target.x, moved.y - target.y])
        self.footholds[foot] = replace(moved, z=target.z)

    def _carry(self, way: Vector) -> None:
        """All that is planned goes with the soles that bear: where they are in W is not known, only estimated."""
        self._soles.carry(way)
        self._dcm.carry(way)
        self._lifted, self._target = moved(self._lifted, way), self._target + way
        self._swing.position[:2] += way

    # Small things -----------------------------------------------------------------------------------------------------

    def _omega(self) -> float:
        return math.sqrt(GRAVITY / max(self._builder.height, 0.1))

    def _urgent(self) -> bool:
        """Whether the DCM is so far from its reference that every moment counts."""
        error = self._measured.dcm(self._omega()) - self._dcm.dcm
        return float(np.linalg.norm(error)) > self.config.adjustment.urgent

    def _must_step(self) -> bool:
        return self._soles.beyond_standing(self._measured.dcm(self._omega()))

    def _loads(self) -> tuple[float, float]:
        """Share of the weight that each foot is to bear, from where the reference's ZMP lies between them."""
        if self.phase is GaitPhase.STAND:
            return 1.0, 1.0
        if self.phase is GaitPhase.SINGLE:
            return (1.0, 0.0) if self.stance == 0 else (0.0, 1.0)
        if self._plan.urgent:
            return 1.0, 1.0  # whatever catches it
        return self._soles.shares(self._dcm.zmp(self._omega()))
