"""The gait: when which foot lifts and lands, and what the whole body is to track meanwhile."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from models.constants import GRAVITY
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import Reference, RobotState
from planners.gait.config import GaitConfig
from planners.gait.current_step import CurrentStep
from planners.gait.dcm_reference import DcmReference
from planners.gait.footing import Footing
from planners.gait.footstep_plan import Footstep
from planners.gait.footsteps import Foothold
from planners.gait.leg_lever import leg_lever
from planners.gait.lifted import Lifted
from planners.gait.measurement import GaitMeasurement
from planners.gait.orders import Orders
from planners.gait.phase import GaitPhase
from planners.gait.reaction import SwingReaction
from planners.gait.reference import ReferenceBuilder
from planners.gait.route import Route
from planners.gait.scaling import load_gait_config
from planners.gait.soles import Soles
from planners.gait.view import GaitView
from planners.gait.weight_shift import WeightShift


class GaitPlanner:
    """Walks at a commanded velocity and stands still when none is commanded.

        stand -> start -> single <-> double -> finish -> stand

    Single supports (``current_step.py``) end with the measured contact, or later with it: time alone never puts a foot
    down. In every phase the DCM reference is the closed form that ends where the coming steps need it (``dcm.py``).
    What the walk is for, and how many steps of it are left, is in ``orders.py``.

    Args:
        model: The robot.
        config: The gait; that of the robot when None.

    Attributes:
        phase: Phase now.
        stance: The foot that bears in single support, or that will.
        steps: Touchdowns so far.
    """

    def __init__(self, model: RobotModel, config: GaitConfig | None = None) -> None:
        self.model = model
        self.config = config = config or load_gait_config(model)
        self._measured = GaitMeasurement(model)
        self._orders = Orders(config)
        self._soles = Soles(model, config)
        self._reaction = reaction = SwingReaction(leg_lever(model))
        self._dcm = DcmReference(reaction)
        self._step = CurrentStep(config, self._measured, self._soles, self._orders, self._dcm, reaction)
        self._weight = WeightShift(config, self._soles, self._dcm, self._step)
        self._builder = ReferenceBuilder(model, config, reaction)
        self._lifted_off = Lifted(model, config.lift)
        self._footing = Footing(model, config.footing)
        self.phase = GaitPhase.STAND
        self.stance = 1
        self.steps = 0
        self._elapsed = 0.0
        self._settled = 0.0
        self._early = 0.0
        self._caught = False

    @property
    def footholds(self) -> list[Foothold]:
        """Planned pose of each sole, or the target of the one that swings."""
        return self._soles.holds

    @property
    def step_time(self) -> float:
        """Planned single support of the step under way [s]."""
        return self._step.time

    @property
    def route(self) -> Route:
        """Footsteps that are being taken instead of a velocity's."""
        return self._orders.route

    @property
    def trips(self) -> int:
        """How often a swing foot was caught by something so far."""
        return self._step.swing.trips

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
            steps_left=self._orders.steps_left,
            velocity=self._orders.velocity,
            dcm=self._measured.dcm(self._omega()),
            omega=self._omega(),
            soles=self._soles,
            unsolved=self._step.plan.unsolved,
            route=self.route,
        )

    def reset(self, state: RobotState) -> None:
        """Start over from a robot that stands on both feet."""
        self._stand(state)
        self.steps = 0

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Wanted velocity of the body in its own frame [m/s, m/s, rad/s]; brought into the limits.

        Zero stands still, but leaves a route alone; any other velocity ends it. One that was commanded when the
        robot was lifted counts for nothing until it has been zero.

        Raises:
            CommandError: A value is not finite.
        """
        self._orders.set_velocity(forward, left, turn)

    def stop(self) -> None:
        """Come to a standstill within two steps."""
        self._orders.stop()

    def walk_to(self, goal: Foothold) -> None:
        """Walk to a pose of the middle between the soles, in W, and stand there; see ``plan_to_pose`` for refusals."""
        foot, under_way = None, None
        if self.phase is GaitPhase.SINGLE:
            foot, under_way = self.stance, Footstep(1 - self.stance, self.footholds[1 - self.stance])
        elif self.phase.stepping:
            foot = 1 - self.stance
        self._orders.walk_to(goal, self.footholds, foot, under_way)

    def take_steps(self, steps: Sequence[Footstep]) -> None:
        """Take footsteps, from standing, and stand there; see ``check_footsteps`` for further refusals.

        Raises:
            CommandError: The robot is walking.
        """
        if self.walking:
            raise CommandError("footsteps refused: they start from where the robot stands, and it is walking; stop it")
        self._orders.take_steps(steps, self.footholds)

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
        # All that is planned goes with the soles that bear: where they are in W is not known, only estimated.
        way = self._soles.drift(self._measured, swinging)
        for part in (self._soles, self._dcm, self._step):
            part.carry(way)
        self._soles.follow(self._measured, swinging, landed, dt)
        self._orders.heed(self.phase.stepping, dt)
        getattr(self, f"_in_{self.phase.value}")(dt)
        return self._builder.build(
            self.footholds,
            self._soles.tilts,
            self._step.swing if self.phase is GaitPhase.SINGLE else None,
            1 - self.stance,
            self._weight.loads(self.phase, self.stance, self._omega()),
            self._measured.com,
            self.config.lean_urgent if self._step.plan.urgent else 0.5,
            self._dcm.dcm,
            self._dcm.rate,
            areas=self._footing.update(self._measured, swinging, dt, hurried=self._step.plan.urgent),
            upright=self.phase.resting,
            dt=dt,
        )

    def _in_stand(self, dt: float) -> None:
        self._weight.to_middle(self._elapsed)
        off = self._measured.dcm(self._omega()) - self._soles.middle()
        self._settled = self._settled + dt if float(np.linalg.norm(off)) < self.config.settle_dcm else 0.0
        if self._must_step():
            self._recover()
        elif self._orders.moving:
            self._begin()
        elif self._caught:
            self._caught = False
            if self._soles.astride(self.config.astride):  # no stance to stay in
                self._begin()

    def _in_start(self, dt: float) -> None:
        if self._weight.to_first(self.stance, self._elapsed, self._omega()):
            self._lift()

    def _in_double(self, dt: float) -> None:
        if self._weight.to_next(self.stance, self._elapsed - self._early, self._omega()):
            self._lift()

    def _in_finish(self, dt: float) -> None:
        there = self._weight.to_middle(self._elapsed)
        if self._must_step():
            self._recover()
        elif there:
            self._enter(GaitPhase.STAND)

    def _in_single(self, dt: float) -> None:
        self._step.step(self.stance, self._elapsed, self._omega(), dt)
        if self._step.landed(self.stance, self._elapsed):
            self._land(1 - self.stance)

    def _hangs(self, state: RobotState, dt: float) -> bool:
        """Whether the robot is in the air; put down, it stands where it is and waits for a new command."""
        lifted, (left, right) = self._lifted_off, self._measured.active
        if lifted.update((left, right), state, dt):
            self._stand(state)
            self._orders.cancel("the robot was put down")
        elif lifted.confirmed and self.phase is not GaitPhase.LIFTED:
            self._orders.cancel("the robot was lifted")
            self._enter(GaitPhase.LIFTED)
        # Quick, wide steps leave the floor for some ticks: holding the robot then would be its fall.
        return lifted.active and (lifted.confirmed or not self._step.plan.urgent)

    def _stand(self, state: RobotState) -> None:
        """Forget the walk: the robot stands where it is."""
        measured = self._measured
        measured.update(state)
        self._soles.reset(measured)
        self._orders.reset()
        self._builder.reset(measured.com[2] - self._soles.ground())
        self._dcm.reset(measured.com[:2])
        self._lifted_off.reset()
        self._footing.reset()
        self._caught = False
        self._enter(GaitPhase.STAND)

    def _begin(self) -> None:
        """From standing: shift the weight to the foot that does not swing first."""
        self.stance = 1 - self._orders.first_foot
        self._dcm.begin_blend()
        self._orders.steps_left = None
        self._enter(GaitPhase.START)

    def _recover(self) -> None:
        """A step at once, without a shift of the weight: the foot away from the DCM swings."""
        self.stance = self._soles.nearest(self._measured.dcm(self._omega()))
        self._orders.steps_left = 2
        self._caught = True
        self._lift()

    def _lift(self) -> None:
        self._enter(GaitPhase.SINGLE)
        self._step.lift(self.stance, self._omega())

    def _land(self, foot: int) -> None:
        self.steps += 1
        self._early = max(self.step_time - self._elapsed, 0.0)
        self._soles.land(foot, self._measured)
        self.stance = foot
        orders = self._orders
        orders.landed(self.footholds)
        if orders.over and (self._must_step() or self._soles.astride(self.config.astride_max)):
            orders.steps_left = 1  # not caught yet, or in no stance to come to rest in
        if orders.over:
            self._dcm.begin_blend()
            orders.steps_left = None
            self._enter(GaitPhase.FINISH)
        else:
            self._enter(GaitPhase.DOUBLE)

    def _enter(self, phase: GaitPhase) -> None:
        self.phase = phase
        self._elapsed = 0.0
        self._settled = 0.0
        if phase is GaitPhase.STAND:
            self._step.plan.urgent = False
            self._dcm.begin_blend()

    def _omega(self) -> float:
        return math.sqrt(GRAVITY / max(self._builder.height, 0.1))

    def _must_step(self) -> bool:
        return self._soles.beyond_standing(self._measured.dcm(self._omega()))
