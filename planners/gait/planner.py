"""Gait planner: lift-off and touchdown of the feet, and the whole-body reference."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from msgspec import structs

from models.constants import GRAVITY
from models.errors import CommandError
from models.numerics.unboxed import Unboxed
from models.robot_model import RobotModel
from models.types import ContactState, Reference, RobotState, Vector, Velocity
from planners.gait.ankle import AnkleStops
from planners.gait.commands import Commands, CommandState, exceeded
from planners.gait.config import GaitConfig
from planners.gait.contact import AirborneDetector, Soles
from planners.gait.dcm import DcmState, double_support
from planners.gait.footing import Footing
from planners.gait.footsteps import Feet, Foothold, replaced, side_of
from planners.gait.measurement import BodyMotion, GaitMeasurement, Ground, Measurement, filtered_dcm_rate
from planners.gait.pace import longest_step, lost_share, pace_at, share_of, share_within, urgency_after
from planners.gait.reference import ReferenceBuilder
from planners.gait.route import Footstep, Route, soles_after
from planners.gait.scaling import load_gait_config
from planners.gait.single_support import SingleSupport, walk_of
from planners.gait.speed import SpeedTrim
from planners.gait.state import BodyState, GaitPhase, GaitState, GaitView, Rest, StepState
from planners.gait.strength import leg_limits

_STILL = np.zeros(2)  #: Rate of a DCM at rest [m/s]
_ON_FLOOR = 0.01  #: Largest height of a sole on the floor above its foothold [m]
_SWAP_ADVANTAGE = 0.01  #: Least reduction of the missed distance for which the stance foot is changed [m]


class GaitPlanner:
    """Walks at a commanded velocity, and stands still when the command is zero.

        stand -> start -> single <-> double -> finish -> stand

    A measured contact ends a single support, early or late; time alone never does. In every phase, the DCM reference is
    a closed form whose final value is the start of the coming steps (``dcm.py``).

    The next tick depends only on ``state`` and its inputs. The laws of the other modules take parts of the state and
    return new ones; only this class and ``SingleSupport`` store them. Construction compiles all kernels.
    """

    def __init__(self, model: RobotModel, config: GaitConfig | None = None) -> None:
        self.model = model
        self.config = config = config or load_gait_config(model)
        self._sensors = GaitMeasurement(model, config.footing.lie_angle)
        self._commands = Commands(config)
        self._soles = Soles(model, config)
        self._footing, self._stops = Footing(model, config.footing), AnkleStops(model, config.ankle)
        self._single = SingleSupport(model, config, self._soles)
        self._builder = ReferenceBuilder(model, config)
        self._airborne = AirborneDetector(model, config.lift)
        self.state = self._warm_up()

    @property
    def phase(self) -> GaitPhase:
        """Present phase."""
        return self.state.phase

    @property
    def stance(self) -> int:
        """Present or next stance foot (0 left, 1 right)."""
        return self.state.stance

    @property
    def steps(self) -> int:
        """Number of touchdowns."""
        return self.state.steps

    @property
    def footholds(self) -> Feet:
        """Planned pose of each sole, or the target of the swing foot."""
        return self.state.soles.holds

    @property
    def route(self) -> Route:
        """Footsteps that replace the footsteps of a velocity."""
        return self.state.command.route

    @property
    def trips(self) -> int:
        """Number of trips of a swing foot."""
        return self.state.swing.trips

    @property
    def walking(self) -> bool:
        """Whether the robot takes steps, or returns the weight to the middle."""
        return self.phase is not GaitPhase.STAND

    @property
    def settled(self) -> bool:
        """Whether the robot has stood still for ``settle_time``, and its reference is at rest."""
        gait = self.state
        still = gait.phase is GaitPhase.STAND and (gait.rest is None or gait.rest.standing is not None)
        return still and gait.settled >= self.config.settle_time

    @property
    def view(self) -> GaitView:
        """Record for observers."""
        return GaitView(self.state, self.state.measured.dcm(self.state.omega), self._soles)

    @cached_property
    def limits(self) -> dict[str, str]:
        """Limits of crouch and velocity that the legs determine; see ``leg_limits``."""
        return leg_limits(self.model, self.config)

    def exceeded(self, velocity: Velocity) -> dict[str, str]:
        """Texts about the components of a velocity that exceed the limits, by component."""
        return exceeded(velocity, self.config.velocity, self.limits)

    def reset(self, state: RobotState) -> None:
        """Reset to a robot that stands on both feet."""
        self._stand(self._sensors.measure(state, self.state.measured))
        self.state.steps = 0

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Command a velocity of the body [m/s, m/s, rad/s], clipped to the limits; ``CommandError`` if not finite.

        Zero stops the walk but does not affect a route; any other velocity ends a route. After the robot was lifted,
        velocities are ignored until zero is commanded once.
        """
        self.state.command = self._commands.set_velocity(self.state.command, (forward, left, turn))

    def stop(self) -> None:
        """Come to a standstill within two steps."""
        self.state.command = self.state.command.stopped("stopped")

    def end_route(self, reason: str) -> None:
        """Discard the remaining footsteps; ``reason`` becomes the outcome of the route."""
        command = self.state.command
        self.state.command = structs.replace(command, route=command.route.ended(reason))

    def walk_to(self, goal: Foothold) -> None:
        """Walk to a pose of the middle between the soles, in W, and stand there; see ``plan_to_pose`` for errors."""
        foot, current = None, None
        if self.phase is GaitPhase.SINGLE:
            foot, current = self.stance, Footstep(1 - self.stance, self.footholds[1 - self.stance])
        elif self.phase.stepping:
            foot = 1 - self.stance
        self.state.command = self._commands.walk_to(self.state.command, goal, self.footholds, foot, current)

    def take_steps(self, steps: Sequence[Footstep], after: int | None = None) -> None:
        """Take footsteps, and stand at their end; see ``check_footsteps`` for ``UnreachableError``.

        They start from standing. With ``after``, they replace the footsteps of the route after the touchdown of that
        number (see ``steps``). ``CommandError`` if the robot walks without ``after`` or that touchdown is not ahead.
        """
        command, soles, holds = self.state.command, self.state.soles, self.footholds
        if after is None:
            if self.walking:
                raise CommandError("footsteps refused: the robot walks, and they start from standing; stop it first")
            stance, kept = 1 - steps[0].foot if steps else self.stance, 0
        else:
            stance, kept = self.stance, after - self.steps
            if not 1 <= kept <= command.route.left:
                raise CommandError(
                    f"footsteps refused: they begin after touchdown {after}, the route has touchdowns"
                    f" {self.steps + 1} to {self.steps + command.route.left}"
                )
            if self.phase is GaitPhase.SINGLE:
                holds = replaced(holds, 1 - stance, self.state.step.liftoff)
        self.state.command = self._commands.take_steps(command, steps, holds, soles.levels, stance, kept)

    def soles_after(self, count: int) -> Feet:
        """Left and right sole after the next ``count`` footsteps of the route, with heights in W."""
        soles, stance = self.state.soles, self.stance
        return soles_after(self.route.steps[:count], soles.holds, soles.holds[stance].z - soles.levels[stance])

    def step(
        self, state: RobotState, dt: float, rest: Rest | None = None, motion: Unboxed[BodyMotion] | None = None
    ) -> Reference:
        """Advance by one tick of ``dt`` [s]; returns the reference of the whole-body controller.

        ``rest`` is the stance of the robot while it takes no steps; over the middle of the soles when None. While the
        robot stands still, ``rest.standing`` is the reference, on the bearing areas of the soles. ``motion`` is CoM and
        soles of the same ``state``, computed from it when None.
        """
        gait = self.state
        before = gait.measured
        gait.measured = measured = self._sensors.measure(
            state, before, motion, Ground(gait.footing.areas, gait.soles.slope)
        )
        share = min(dt / self.config.push_filter, 1.0)
        states = before.com, before.com_velocity, measured.com, measured.com_velocity
        rate, gait.dcm_rate = gait.dcm_rate, np.empty(2)
        filtered_dcm_rate(rate, *states, gait.omega, dt, share, gait.dcm_rate)
        if rest is not None and gait.rest is not None and gait.phase is GaitPhase.STAND:  # a posture moves the CoM
            gait.body = structs.replace(gait.body, height=gait.body.height + rest.height - gait.rest.height)
        gait.rest = rest
        if self._off_the_floor(state, dt):
            return self._builder.build_airborne(gait.airborne, state, measured)
        gait = self.state
        gait.elapsed += dt
        swinging = 1 - gait.stance if gait.phase is GaitPhase.SINGLE else None
        self._follow_soles(swinging, dt)
        longest = longest_step(state.friction, gait.body.height, self.config.reach.width, self.config.pace)
        gait.command = self._commands.advance(gait.command, gait.phase.stepping, dt, longest)
        self._set_pace(dt, longest)
        cmp_offset = None
        match gait.phase:
            case GaitPhase.STAND:
                self._in_stand(dt)
            case GaitPhase.START:
                self._in_start()
            case GaitPhase.SINGLE:
                cmp_offset = self._in_single(dt)
            case GaitPhase.DOUBLE:
                self._in_double()
            case GaitPhase.FINISH:
                self._in_finish()
        if gait.phase is not GaitPhase.SINGLE:
            cmp_offset = None
        elif cmp_offset is None:  # the foot has just lifted
            _, cmp_offset = self._single.reference(gait)
        slope = self._soles.expected_slope(gait.soles)
        gait.footing = self._footing.update(gait.footing, measured, swinging, slope, dt, urgent=gait.step.urgent)
        if swinging is not None and gait.step.urgent:
            stance = 1 - swinging
            areas = self._stops.on_edge(stance, state, measured.cops[stance], gait.footing.areas)
            gait.footing = structs.replace(gait.footing, areas=areas)
        loads, gait.body = self._loads(), self._builder.advance_body(gait, self._relief_dcm(), gait.omega, dt)
        if gait.phase is GaitPhase.STAND and rest is not None and rest.standing is not None:
            return structs.replace(rest.standing, sole_areas=gait.footing.areas)
        return self._builder.build(gait, loads, cmp_offset)

    def _follow_soles(self, swinging: int | None, dt: float) -> None:
        """Shift the whole plan with the loaded soles, whose estimated pose in W drifts."""
        gait, measured = self.state, self.state.measured
        landed = gait.stance if gait.phase is GaitPhase.DOUBLE else None
        gait.soles, (x, y) = self._soles.followed(gait.soles, measured, swinging, landed, dt)
        gait.dcm = gait.dcm.shifted(np.array((x, y)))
        if gait.phase.stepping:
            gait.step = gait.step.shifted(x, y)
        if swinging is not None:  # otherwise the next lift-off sets the swing
            gait.swing = gait.swing.shifted(x, y)

    def _in_stand(self, dt: float) -> None:
        gait = self.state
        self._shift_to_middle()
        off, velocity = gait.measured.dcm(gait.omega) - self._rest_dcm, gait.measured.com_velocity[:2]
        if gait.rest is not None:
            velocity = velocity - gait.rest.velocity
        config, drift = self.config, math.hypot(*velocity.tolist())
        at_rest = math.hypot(*off.tolist()) < config.settle_dcm and drift < config.settle_speed
        gait.settled = gait.settled + dt if at_rest else 0.0
        if self.must_step:
            self._recover()
        elif gait.command.moving and (gait.rest is None or gait.rest.walk):
            self._begin()
        elif gait.recovering:
            gait.recovering = False
            if self._soles.astride(gait.soles.holds, self.config.astride):  # too far from the nominal stance
                self._begin()

    def _in_start(self) -> None:
        gait, duration = self.state, self.config.timing.start
        omega, walk = gait.omega, walk_of(gait, gait.soles.holds[1 - gait.stance])
        end = self._single.plan.start_of_single(walk)
        rate = omega * (end - self._soles.stance_point(gait.soles, gait.stance))
        gait.dcm = gait.dcm.blended(end, rate, gait.elapsed, duration)
        if self.must_step:
            self._recover()
        elif gait.elapsed >= duration:
            self._lift(self._single.far_off(gait))

    def _in_double(self) -> None:
        gait, duration = self.state, self.state.step.double
        elapsed, point = gait.elapsed - gait.early, self._soles.stance_point(gait.soles, gait.stance)
        gait.dcm = gait.dcm.in_double(point, gait.step.touchdown, gait.omega, elapsed, duration)
        bears, other, far_off = gait.measured.active, 1 - gait.stance, self._single.far_off(gait)
        # A foot that has just lost its load can bear load again while it is on the floor.
        on_floor = bears[other] or gait.measured.soles[other].z - gait.soles.holds[other].z < _ON_FLOOR
        dragged = bears[gait.stance] and not on_floor  # by the body, after a wide step
        if far_off and bears[gait.stance] and on_floor and not gait.command.route.steps:
            self._choose_stance()
        if elapsed >= duration or far_off or dragged:
            self._lift(far_off)

    def _in_finish(self) -> None:
        self._shift_to_middle()
        if self.must_step:
            self._recover()
        elif self.state.elapsed >= self.config.timing.finish:
            self._enter(GaitPhase.STAND)

    def _shift_to_middle(self) -> None:
        """Blend to rest: the DCM reference of phases ``STAND`` and ``FINISH``."""
        gait = self.state
        gait.dcm = gait.dcm.blended(self._rest_dcm, _STILL, gait.elapsed, self.config.timing.finish)

    def _relief_dcm(self) -> float:
        """Vertical DCM from the known heights of the coming footholds [m]."""
        gait, levels, omega = self.state, self.state.soles.levels, self.state.omega
        felt = levels[0] == levels[1] and gait.soles.landing is None and not gait.command.route.known
        if felt or not gait.phase.stepping:
            return 0.5 * (levels[0] + levels[1])
        level, end = levels[gait.stance], self._single.plan.height_at_touchdown(walk_of(gait, gait.step.liftoff))
        if gait.phase is GaitPhase.SINGLE:
            return level + math.exp(-omega * max(gait.step.time - gait.elapsed, 0.0)) * (end - level)
        end = level + math.exp(-omega * gait.single) * (end - level)
        if gait.phase is GaitPhase.START:
            return end
        elapsed, old = gait.elapsed - gait.early, levels[1 - gait.stance]
        first, last, then = (np.array((height, 0.0)) for height in (old, level, end))
        return float(double_support(first, last, then, omega, elapsed, gait.step.double)[0][0])

    def _lift(self, urgent: bool) -> None:
        self._enter(GaitPhase.SINGLE)
        self._single.lift(self.state, urgent)

    def _in_single(self, dt: float) -> Vector:
        """One tick of the step; returns CMP minus CoP (2,) [m]."""
        cmp_offset = self._single.advance(self.state, dt)
        if self._single.lands(self.state):
            self._land(1 - self.stance)
        return cmp_offset

    def _land(self, foot: int) -> None:
        gait = self.state
        gait.steps += 1
        self._learn_speed(foot)
        gait.early = max(gait.step.time - gait.elapsed, 0.0)
        missed = abs(gait.step.time - gait.elapsed) * math.hypot(*gait.dcm_rate.tolist())  # uneven ground [m]
        gait.urgency = urgency_after(gait.urgency, missed, 0.0, self.config.pace)
        gait.soles = self._soles.landed(gait.soles, foot, gait.measured, flat=gait.footing.lies_flat(1 - foot))
        gait.stance = foot
        gait.step = structs.replace(gait.step, double=gait.pace.double)
        command = self._commands.landed(gait.command, gait.soles.holds)
        if command.over and (self.must_step or self._soles.astride(gait.soles.holds, self.config.astride_max)):
            command = command.counted(1)  # not recovered yet, or too far from the nominal stance to rest
        if command.over:
            gait.dcm = gait.dcm.begin_blend()
            command = command.counted(None)
            self._enter(GaitPhase.FINISH)
        else:
            self._enter(GaitPhase.DOUBLE)
        gait.command = command

    def _learn_speed(self, foot: int) -> None:
        """Update the speed correction at a touchdown; rough ground shortens steps, so these are not used."""
        gait, config, command = self.state, self.config, self.state.command
        trim, reached, step = structs.replace(command.trim, steady=None), gait.measured.soles[foot], gait.step
        going_on = not command.route.steps and command.steps_left is None
        if going_on and not step.urgent and gait.soles.roughness == 0.0:
            middle, period = (0.0, -0.5 * side_of(foot) * config.reach.width), gait.early + step.double + gait.elapsed
            trim = command.trim.landed(
                command.velocity, step.liftoff, reached, middle, period, config.speed, config.pace
            )
        gait.command = structs.replace(command, trim=trim)

    def _loads(self) -> tuple[float, float]:
        """Share of the weight on each foot, from the reference ZMP between the feet."""
        gait = self.state
        if gait.phase is GaitPhase.STAND:
            return 1.0, 1.0
        if gait.phase is GaitPhase.SINGLE:
            return (1.0, 0.0) if gait.stance == 0 else (0.0, 1.0)
        if gait.step.urgent:
            return 1.0, 1.0  # both feet may bear any load to catch the robot
        return self._soles.shares(gait.soles.holds, gait.dcm.zmp(gait.omega))

    def _off_the_floor(self, state: RobotState, dt: float) -> bool:
        """Whether the robot is in the air; after it is put down, it stands until a new command."""
        gait = self.state
        if gait.phase is GaitPhase.STAND and gait.rest is not None and not gait.rest.walk:
            return False  # a robot that is lowered onto its feet must take its weight
        gait.airborne, put_down = self._airborne.update(gait.airborne, gait.measured.active, state.q[7:], dt)
        if put_down:
            self._stand(gait.measured)
            gait = self.state
            gait.command = gait.command.stopped("the robot was lowered", muted=True)
        elif gait.airborne.confirmed and gait.phase is not GaitPhase.LIFTED:
            gait.command = gait.command.stopped("the robot was lifted", muted=True)
            self._enter(GaitPhase.LIFTED)
        # In quick, wide steps both feet leave the floor for some ticks; holding the posture would cause a fall.
        return gait.airborne.active and (gait.airborne.confirmed or not gait.step.urgent)

    def _stand(self, measured: Measurement) -> None:
        """End the walk; the robot stands at its measured place."""
        before, soles = self.state, self._soles.planted(measured)
        self.state = replace(
            before,
            measured=measured,
            dcm_rate=np.zeros(2),
            soles=soles,
            footing=self._footing.whole(),
            step=self._at_rest(before.step),
            dcm=DcmState.at_rest(measured.com[:2], before.dcm.old),
            body=BodyState(float(measured.com[2]) - soles.ground()),
            airborne=self._airborne.on_floor,
            command=CommandState(route=before.command.route.ended("the walk started again")),
            phase=GaitPhase.STAND,
            elapsed=0.0,
            settled=0.0,
            urgency=0.0,
            recovering=False,
            rest=None,
        )

    def _begin(self) -> None:
        """Start to walk from standing: shift the weight to the first stance foot."""
        gait = self.state
        gait.stance = 1 - gait.command.first_foot
        gait.dcm = gait.dcm.begin_blend()
        gait.command = structs.replace(gait.command, steps_left=None, trim=SpeedTrim())
        self._enter(GaitPhase.START)

    def _recover(self) -> None:
        """Step at once; the swing foot is the one farther from the DCM, unless ``_choose_stance`` changes it.

        A route that starts with the other foot is replanned.
        """
        gait = self.state
        gait.stance = self._soles.nearest(gait.soles.holds, gait.measured.dcm(gait.omega))
        self._choose_stance()
        route, foot = gait.command.route, 1 - gait.stance
        if route.steps and route.foot != foot:
            route = route.planned_anew(foot, gait.soles.holds, self.config)
        gait.command = structs.replace(gait.command, route=route, steps_left=2)
        gait.recovering = True
        self._lift(self._single.far_off(gait))

    def _choose_stance(self) -> None:
        """Change the stance foot if a step from the other one misses the DCM after ``push_horizon`` by less."""
        gait, omega, holds = self.state, self.state.omega, self.state.soles.holds
        ahead = gait.measured.dcm(omega) + self.config.push_horizon * gait.dcm_rate
        missed = [self._single.plan.missed(holds, 1 - stance, ahead, omega) for stance in range(2)]
        if missed[1 - gait.stance] < missed[gait.stance] - _SWAP_ADVANTAGE:
            gait.stance = 1 - gait.stance

    def _enter(self, phase: GaitPhase) -> None:
        gait = self.state
        gait.phase, gait.elapsed, gait.settled = phase, 0.0, 0.0
        if phase is GaitPhase.STAND:
            gait.step = self._at_rest(gait.step)
            gait.dcm = gait.dcm.begin_blend()

    def _at_rest(self, step: StepState) -> StepState:
        """Step state of a standing robot, in which the last step does not affect the next one."""
        return structs.replace(step, urgent=False, double=self.config.pace.slow.double)

    @property
    def _rest_dcm(self) -> Vector:
        """DCM of a robot at rest (2,) [m]."""
        rest = self.state.rest
        return self._soles.middle(self.state.soles.holds) if rest is None else rest.dcm

    def _set_pace(self, dt: float, longest: float) -> None:
        """Set the pace for the commanded velocity, its ``longest`` step [m] and the present disturbance."""
        gait, config = self.state, self.config.pace
        lost = lost_share(gait.footing.areas, self._soles.half)
        gait.urgency = max(urgency_after(gait.urgency, gait.dcm_error, dt, config), lost)
        velocity = gait.command.velocity
        share = self.config.route.pace if gait.command.route.steps else share_of(velocity, config)
        pace = pace_at(max(share, share_within(velocity, longest, config)), config, gait.urgency)
        rough = 0.0 if gait.command.route.known else gait.soles.roughness
        gait.pace = pace._replace(clearance=pace.clearance + rough)

    @property
    def must_step(self) -> bool:
        """Whether a standing robot cannot recover from the DCM without a step."""
        if self.state.rest is not None and not self.state.rest.step:
            return False
        return self._soles.beyond_standing(self.state.soles.holds, self.state.measured.dcm(self.state.omega))

    def _warm_up(self) -> GaitState:
        """State of the standing robot; a simulated first step compiles every kernel."""
        model = self.model
        weight = np.array([0.0, 0.0, 0.5 * model.mass * GRAVITY, 0.0, 0.0, 0.0])
        contact = ContactState(True, weight)
        robot = RobotState(
            0.0, model.standing_configuration(), np.zeros(model.nv), np.zeros(model.nj), (contact, contact)
        )
        measured, pace = self._sensors.measure(robot), pace_at(0.0, self.config.pace)
        at_rest = GaitState(
            measured,
            np.zeros(2),
            self._soles.planted(measured),
            self._footing.whole(),
            StepState(pace.single, pace.double, np.zeros(2)),
            DcmState.at_rest(measured.com[:2]),
            BodyState(self._builder.standing_height),
            self._airborne.on_floor,
            pace,
        )
        self.state = at_rest.copy()
        velocity = (self.config.velocity.forward, 0.0, 0.0)
        self.state.command = self._commands.set_velocity(CommandState(), velocity)
        for dt in (self.config.timing.start, self.config.timing.start, self.config.timing.adjust_period):
            self.step(robot, dt)
        self._single.compile_rest(at_rest)
        at_rest.dcm.in_double(at_rest.dcm.old, at_rest.dcm.old, self.state.omega, -1.0, 1.0)  # not called either
        return at_rest
