"""Single support: foothold and time, swing foot and DCM reference of the present step."""

import math

import numpy as np
from msgspec import structs

from models.numerics.unboxed import unbox
from models.robot_model import RobotModel
from models.types import Vector
from planners.gait.adjustment import PlannedStep, StepPlanner, Walk
from planners.gait.config import GaitConfig
from planners.gait.contact import Soles
from planners.gait.dcm import DcmState, single_support
from planners.gait.footsteps import Foothold, Point, clamped, replaced, wrap
from planners.gait.reaction import SwingLeg, leg_lever
from planners.gait.regions import Region, region_limits
from planners.gait.state import GaitPhase, GaitState
from planners.gait.swing import SwingFoot


def walk_of(gait: GaitState, liftoff: Foothold) -> Walk:
    """The walk at the next or present step; the swing foot lifts off from ``liftoff``."""
    soles, stance = gait.soles, gait.stance
    hold, urgent = soles.holds[stance], gait.step.urgent
    return Walk(hold, 1 - stance, liftoff, gait.command, gait.pace, gait.omega, urgent, soles.levels, soles.landing)


class SingleSupport:
    """Executes the present step; ``GaitPlanner`` decides when it begins and ends.

    Methods replace parts of the ``GaitState``.
    """

    def __init__(self, model: RobotModel, config: GaitConfig, soles: Soles) -> None:
        self._config, self._soles = config, soles
        self._swing = SwingFoot(config.swing)
        leg = SwingLeg(self._swing.shape, leg_lever(model))
        self._leg = unbox(leg)
        self.plan = StepPlanner(config, soles, leg)
        self._regions = region_limits(config.reach)

    def far_off(self, gait: GaitState) -> bool:
        """Whether the DCM is so far from its reference that the step is urgent.

        In double support after an urgent step, its distance from the nominal start of the coming single support counts,
        too: the reference continues the plan of a step that may have been too short to catch the robot.
        """
        most = self._config.adjustment.urgent
        if gait.dcm_error > most or not (gait.step.urgent and gait.phase is GaitPhase.DOUBLE):
            return gait.dcm_error > most
        start = self.plan.start_of_single(walk_of(gait, gait.soles.holds[1 - gait.stance]))
        return math.dist(gait.measured.dcm(gait.omega), start) > most

    def lift(self, gait: GaitState, urgent: bool) -> None:
        """Lift the swing foot off at its measured pose."""
        foot, single = 1 - gait.stance, gait.single
        sole = gait.measured.soles[foot]
        pose = np.array([sole.x, sole.y, sole.z, sole.yaw])
        gait.step = structs.replace(
            gait.step,
            time=single,
            liftoff=sole,
            next_adjustment=0.0,
            urgent=urgent,
            region=Region.OWN,
            via=None,
        )
        landing = gait.command.route.steps[0] if gait.command.route.known else None
        gait.soles = structs.replace(gait.soles, landing=landing)
        walk = walk_of(gait, sole)
        nominal, _ = self.plan.nominal(walk)
        rise, over = walk.rise + nominal.z - walk.stance.z, 0.0 if landing is None else landing.over
        gait.soles = structs.replace(gait.soles, holds=replaced(gait.soles.holds, foot, nominal))
        tilt, trips, target, pace = gait.soles.tilts[foot], gait.swing.trips, (nominal.x, nominal.y), gait.pace
        gait.swing = self._swing.lift(pose, pace.clearance, single, tilt, trips, target, pace.least_effort, rise, over)
        self._adjust(gait, 0.0)

    def advance(self, gait: GaitState, dt: float) -> Vector:
        """One tick of the step; returns CMP minus CoP (2,) [m]."""
        config, foot = self._config, 1 - gait.stance
        measured, elapsed, left = gait.measured, gait.elapsed, gait.step.time - gait.elapsed
        if elapsed >= gait.step.next_adjustment and left > config.swing.freeze:
            self._adjust(gait, elapsed)
            if elapsed > config.ground.settled and gait.footing.lies_flat(gait.stance):
                gait.soles = self._soles.standing_on(gait.soles, gait.stance, measured)
            gait.step = structs.replace(gait.step, next_adjustment=elapsed + config.timing.adjust_period)
        target_velocity = self._shift_late_target(gait, dt) if left < 0.0 else (0.0, 0.0)
        target, sole, urgent = gait.soles.holds[foot], measured.soles[foot], gait.step.urgent
        yaw = float(gait.swing.position[3])
        level = self._soles.landing_height(gait.soles, foot, measured)
        height = max(level, min(gait.swing.edge, level + config.ground.rough_max))
        pose = np.array([target.x, target.y, height, yaw + wrap(target.yaw - yaw)])
        swing = gait.swing
        swing = self._swing.detect_trip(swing, sole, measured.forces[foot], elapsed, gait.step.time)
        if swing.trips > gait.swing.trips:
            before, gait.soles = gait.soles.roughness, self._soles.tripped(gait.soles)
            swing = structs.replace(swing, clearance=swing.clearance + gait.soles.roughness - before)
        # The foot of an urgent step lags behind its reference; a late landing is worse than an early one.
        lead = config.swing.urgent_lead if urgent else 0.0
        duration = gait.step.time - lead
        slope, via, effort = self._soles.expected_slope(gait.soles), gait.step.via, gait.pace.least_effort
        gait.swing = self._swing.step(swing, pose, slope, elapsed, duration, dt, via, effort, target_velocity)
        gait.dcm, cmp_offset = self.reference(gait)
        return cmp_offset

    def lands(self, gait: GaitState) -> bool:
        """Whether the swing foot bears load on ground below it, after the share ``landing_from`` of the step."""
        foot, least = 1 - gait.stance, self._config.timing.landing_from * gait.step.time
        return gait.measured.active[foot] and gait.measured.upright(foot) and gait.elapsed > least

    def reference(self, gait: GaitState) -> tuple[DcmState, Vector]:
        """DCM reference for the rest of the swing, and present CMP minus CoP (2,) [m].

        While the foot is late, the reference comes to rest, and the ankle of the stance foot holds the DCM.
        """
        measured, target, left = gait.measured, gait.soles.holds[1 - gait.stance], gait.step.time - gait.elapsed
        swing = gait.swing.towards(target.x, target.y)
        point, body = self._soles.stance_point(gait.soles, gait.stance), (measured.com, measured.com_velocity)
        out = np.empty((3, 2))
        single_support(point, gait.step.touchdown, gait.omega, left, swing, body, self._leg, out)
        moving = min(max(1.0 + left / self._config.swing.late_time, 0.0), 1.0)
        return gait.dcm.in_single(point, out[0], moving * out[1]), out[2]

    def compile_rest(self, gait: GaitState) -> None:
        """Compile the kernels that the first step does not call."""
        self._swing.detect_trip(gait.swing, gait.step.liftoff, np.zeros(3), 0.0, 1.0)
        self.plan.height_at_touchdown(walk_of(gait, gait.step.liftoff))

    def _adjust(self, gait: GaitState, elapsed: float) -> None:
        """Adjust foothold and time to the measured DCM."""
        foot = 1 - gait.stance
        gait.step = step = structs.replace(gait.step, urgent=gait.step.urgent or self.far_off(gait))
        last = PlannedStep(gait.soles.holds[foot], step.time, step.touchdown, region=step.region, via=step.via)
        plan = self.plan.adjust(walk_of(gait, step.liftoff), gait.measured, elapsed, last, gait.swing)
        gait.soles = structs.replace(gait.soles, holds=replaced(gait.soles.holds, foot, plan.hold))
        gait.step = structs.replace(
            step,
            time=plan.time,
            touchdown=plan.end,
            region=plan.region,
            via=plan.via,
            unsolved=step.unsolved + (not plan.solved),
        )

    def _shift_late_target(self, gait: GaitState, dt: float) -> Point:
        """Move the target of a late foot with the DCM, to keep its planned offset; returns the velocity [m/s]."""
        foot, holds = 1 - gait.stance, gait.soles.holds
        share = min(dt / self._config.swing.late_time, 1.0)
        target, run = holds[foot], share * (gait.measured.dcm(gait.omega) - gait.step.touchdown)
        limits = self._regions[gait.step.region]
        x, y = target.x + float(run[0]), target.y + float(run[1])
        shifted = clamped(holds[gait.stance], foot, x, y, target.yaw, limits)
        landing = gait.soles.landing
        if landing is not None:
            shifted = landing.kept(shifted)
        way = shifted.x - target.x, shifted.y - target.y
        gait.step = structs.replace(gait.step, touchdown=gait.step.touchdown + np.array(way))
        hold = Foothold(shifted.x, shifted.y, shifted.yaw, target.z)
        gait.soles = structs.replace(gait.soles, holds=replaced(holds, foot, hold))
        return way[0] / dt, way[1] / dt
