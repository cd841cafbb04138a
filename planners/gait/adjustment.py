"""Step adjustment: nominal footholds, and position and time of the next touchdown from the measured DCM."""

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from models.numerics.compiled import njit
from models.numerics.unboxed import Unboxed, unbox
from models.types import Matrix, Vector
from planners.gait.commands import CommandState
from planners.gait.config import GaitConfig
from planners.gait.contact import Soles
from planners.gait.dcm import StepModel, height_at_touchdown, offset_coupling, previewed_offset
from planners.gait.foot_motion import FootLimits
from planners.gait.footsteps import (
    PREVIEWED,
    Feet,
    Foothold,
    Point,
    Pose,
    Preview,
    clamped,
    limits_of,
    point_at,
    preview_steps,
    relative_to,
    rotated,
)
from planners.gait.measurement import Measurement
from planners.gait.pace import Pace, with_single
from planners.gait.reaction import Body, SwingLeg, rest_of_swing, whole_swing
from planners.gait.regions import (
    NOWHERE,
    URGENT_REGIONS,
    Passage,
    Region,
    arrival,
    corner_between,
    divided,
    missed,
    region_boxes,
    region_limits,
)
from planners.gait.route import Footstep
from planners.gait.step_problem import UNSOLVED, StepProblem, Weights, best_step, weights_of
from planners.gait.swing import SwingMotion, SwingState, Via
from planners.gait.tread import ANYWHERE, bounds_in

_HURRY = 0.7  #: Shortest single support of a swing to a known height, as a share of its nominal one [-]


class Walk(Struct, frozen=True):
    """State of a walk at the next or present step."""

    stance: Foothold  #: Foothold of the stance foot
    foot: int  #: Swing foot (0 left, 1 right)
    liftoff: Foothold  #: Foothold of the swing foot before the step
    command: CommandState  #: Velocity or route, and the end of the walk
    pace: Pace  #: Pace of this and the following steps
    omega: float  #: Natural frequency of the pendulum [1/s]
    urgent: bool = False
    levels: Point = (0.0, 0.0)  #: Known heights of both feet before the step, left and right [m]
    landing: Footstep | None = None  #: Known target foothold of the foot in the air, independent of the present command

    @property
    def rise(self) -> float:
        """Known height of the stance foot above the swing foot at lift-off [m]."""
        return self.levels[1 - self.foot] - self.levels[self.foot]


class PlannedStep(Struct, frozen=True):
    """Plan of the present step."""

    hold: Foothold
    time: float  #: Touchdown since lift-off [s]
    end: Vector  #: DCM reference at touchdown, in W (2,) [m]
    solved: bool = True  #: If False, this is the nominal step within the bounds
    region: Region = Region.OWN
    via: Via | None = None  #: Corner that the foot passes
    cost: float = 0.0  #: Objective [-]


class _Underway(NamedTuple):
    """Present step; times since lift-off [s], as in ``StepProblem``."""

    foot: int  #: Swing foot
    region: int  #: A ``Region`` as an int: numba infers the type of an enum argument in Python, which takes 20 us
    kept: bool  #: The last plan has this region; it stays feasible even if the foot can no longer reach it in time
    ends: bool  #: The walk ends with the previewed steps: chooses the weights
    omega: float
    elapsed: float
    planned: float
    soonest: float
    latest: float
    lead: float  #: Time from the end of the swing to the touchdown [s]


class _Nominal(NamedTuple):
    """Nominal step, set by ``_best_of_region`` and used by ``_judge`` and ``_foothold_of``; each (2,) [m]."""

    step: Vector  #: Nominal ZMP point in the stance frame, relative to the ZMP point of the stance
    shift: Vector  #: Displacement from a foothold to its ZMP point, less the ZMP point of the stance
    offset: Vector  #: DCM offset at the nominal touchdown, in W
    dcm: Vector  #: ``StepProblem.dcm``
    place: Vector  #: Position of the swing foot in the stance frame


class _Setup(NamedTuple):
    """Constants and work memory of the adjustments, for compiled code."""

    model: StepModel
    going_on: Weights
    ending: Weights
    passage: Passage
    cop: Matrix  #: Largest CoP offset in each sole (2, 2) [m]
    half: Matrix  #: Half size of each sole (2, 2) [m]
    nominal: _Nominal


class StepPlanner:
    """Plans the present step and the next ones."""

    def __init__(self, config: GaitConfig, soles: Soles, leg: SwingLeg) -> None:
        self._config = config
        self._limits = limits_of(config.reach)
        self._bounds = unbox(self._limits)
        reach = config.reach
        boxes, self._corner = region_boxes(region_limits(reach)), (reach.cross_ahead, reach.width_min)
        foot_limits = FootLimits(config.swing.speed_max, config.swing.acceleration_max)
        nearest = soles.half - np.abs(soles.points - soles.centres)  # edge from the ZMP point (2, 2) [m]
        cop = config.adjustment.cop_share * nearest
        model = StepModel(soles.points, leg)
        self._nominal = _Nominal(*(np.zeros(2) for _ in _Nominal._fields))
        self._soles, self._passage = soles, Passage(self._corner, boxes, foot_limits, config.timing.single_urgent)
        self._setup = unbox(
            _Setup(model, *weights_of(config.adjustment), self._passage, cop, soles.half, self._nominal)
        )

    def nominal(self, walk: Walk) -> tuple[Foothold, Vector]:
        """Next foothold, and the DCM offset at its touchdown in W (2,) [m]."""
        steps = self._coming(walk)
        x, y, yaw, rise, *_ = steps[1].tolist()
        ends = walk.command.steps_left is not None
        offset = _nominal_offset(self._setup, steps, walk.foot, ends, walk.omega, walk.pace)
        return Foothold(x, y, yaw, walk.stance.z + rise), np.array(offset)

    def height_at_touchdown(self, walk: Walk) -> float:
        """Known height of the vertical DCM at the coming touchdown, with the same zero as ``walk.levels`` [m]."""
        ends = walk.command.steps_left is not None
        height = height_at_touchdown(self._coming(walk), ends, walk.omega, walk.pace)
        return walk.levels[1 - walk.foot] + height

    def missed(self, holds: Feet, foot: int, dcm: Vector, omega: float) -> float:
        """Distance [m] by which a quick step from standing misses a DCM (2,) [m]; see ``regions.missed``."""
        stance, points = holds[1 - foot], self._soles.points.tolist()
        origin = Foothold(*stance.moved(*points[1 - foot]), stance.yaw)
        place = origin.relative(*holds[foot].moved(*points[foot]))
        return missed(origin.relative(*dcm), place, foot, self._soles.half[1 - foot], omega, self._passage)

    def start_of_single(self, walk: Walk) -> Vector:
        """DCM at the start of the next single support (2,) [m]."""
        ends, liftoff = walk.command.steps_left is not None, walk.liftoff.pose
        steps, pace = self._coming(walk), walk.pace
        return np.array(_start_of_single(self._setup, steps, walk.foot, ends, walk.omega, pace, liftoff, walk.rise))

    def adjust(
        self, walk: Walk, measured: Measurement, elapsed: float, step: PlannedStep, swing: SwingState
    ) -> PlannedStep:
        """Best step, ``elapsed`` [s] after lift-off; ``step`` is the last plan, at lift-off the nominal step.

        For an urgent step, all regions are evaluated. A region other than that of the last plan must be better by
        ``adjustment.switch``.
        """
        config, steps, omega, dcm = self._config, self._coming(walk), walk.omega, measured.dcm(walk.omega)
        single_min = config.timing.single_urgent if walk.urgent else config.timing.single_min
        # Not active in a step without a trip; limited, so that repeated trips do not delay the touchdown indefinitely.
        tripped = min(swing.rising_until + config.swing.trip_landing, config.timing.single_max)
        soonest = max(single_min, elapsed + config.swing.freeze, _HURRY * float(steps[1]["time"]), tripped)
        latest, ends = max(config.timing.single_max, soonest), walk.command.steps_left is not None
        motion, room = swing.towards(step.hold.x, step.hold.y), self._room(walk)
        body = measured.com, measured.com_velocity
        own, lead = (Region.URGENT, config.swing.urgent_lead) if walk.urgent else (Region.OWN, 0.0)
        last, best, least = step.region if step.region.crossing else own, None, math.inf
        place = walk.stance.relative(*swing.position[:2].tolist())
        for region in URGENT_REGIONS if walk.urgent or last.crossing else (own,):
            kept, corner = region is last, NOWHERE
            if not kept and divided(walk.foot, place, region, self._corner):
                continue
            at = _Underway(walk.foot, int(region), kept, ends, omega, elapsed, step.time, soonest, latest, lead)
            z = np.empty(5)
            for _ in range(2):  # straight, then round the stance foot if it is in the path
                value = _best_of_region(self._setup, steps, at, walk.pace, dcm, motion, body, corner, room, z)
                blocked, missed = _judge(self._setup, at, z)
                if math.isnan(blocked[0]) or not math.isnan(corner[0]):
                    break
                corner = blocked
            cost = value + config.adjustment.capture * missed**2
            cost += 0.0 if kept else config.adjustment.switch
            if best is None or cost < least:
                best, least = (region, z, value < UNSOLVED, corner), cost
        assert best is not None
        region, z, solved, corner = best
        end = np.empty(2)
        x, y = _foothold_of(self._setup, steps, walk.foot, omega, walk.pace, z, end)
        height = walk.stance.z + float(steps[1]["rise"])
        hold, time = Foothold(x, y, float(steps[1]["yaw"]), height), math.log(z[2]) / omega
        via = None
        if not math.isnan(corner[0]):
            before, passed = step.via if step.region is region else None, elapsed + lead
            left = time - passed, step.time - passed
            via = swing.via(walk.stance.moved(*corner), (hold.x, hold.y), elapsed, left, before, config.swing.freeze)
        return PlannedStep(hold, time, end, solved, region, via, least)

    def _room(self, walk: Walk) -> Matrix:
        """Bounds of the position of the swing sole on its tread, in the stance frame (2, 2) [m]."""
        return bounds_in(walk.stance, walk.landing.hold, walk.landing.tread) if walk.landing else ANYWHERE

    def _coming(self, walk: Walk) -> Preview:
        """Present stance and coming footholds (1 + steps,)."""
        count, command, stance, level = self._config.preview, walk.command, walk.stance, walk.levels[1 - walk.foot]
        if command.route.steps:
            ahead = zip(command.route.steps, command.route.ahead(stance, count, self._limits, level), strict=False)
            coming = [(*hold.pose, hold.z - stance.z, step.over, step.time) for step, hold in ahead]
            steps = np.array([(*stance.pose, 0.0, 0.0, 0.0), *coming], PREVIEWED)
            if walk.landing is not None:
                steps["over"][1], steps["time"][1] = walk.landing.over, walk.landing.time
            return steps
        period, velocity, left = walk.pace.period, command.asked, command.steps_left
        if walk.landing is None:
            return preview_steps(stance, walk.foot, velocity, period, self._bounds, count, left)
        first = clamped(stance, walk.foot, *walk.landing.hold.pose, self._limits)
        after = None if left is None else max(left - 1, 1)
        steps = preview_steps(first, 1 - walk.foot, velocity, period, self._bounds, count - 1, after)
        steps["rise"] = walk.landing.hold.z - level
        steps["over"][0], steps["time"][0] = walk.landing.over, walk.landing.time
        return np.concatenate([np.array([(*stance.pose, 0.0, 0.0, 0.0)], PREVIEWED), steps])


@njit(cache=True)
def _nominal_offset(setup: Unboxed[_Setup], steps: Preview, foot: int, ends: bool, omega: float, pace: Pace) -> Point:
    """``previewed_offset`` of the coming footholds."""
    return previewed_offset(steps, foot, ends, omega, pace, setup.record.model)


@njit(cache=True)
def _start_of_single(
    setup: Unboxed[_Setup], steps: Preview, foot: int, ends: bool, omega: float, pace: Pace, liftoff: Pose, rise: float
) -> Point:
    """``StepPlanner.start_of_single``; arguments as for ``previewed_offset``.

    The swing foot lifts off at ``liftoff``, which is below the stance by the known ``rise`` [m].
    """
    model = setup.record.model
    stance, next_hold = steps[0], steps[1]
    stance_centre, centre, yaw = model.points[1 - foot], model.points[foot], stance["yaw"]
    x, y = point_at(stance["x"], stance["y"], yaw, stance_centre[0], stance_centre[1])
    first = point_at(liftoff[0], liftoff[1], liftoff[2], centre[0], centre[1])
    last = point_at(next_hold["x"], next_hold["y"], next_hold["yaw"], centre[0], centre[1])
    offset, slow = previewed_offset(steps, foot, ends, omega, pace, model), with_single(pace, next_hold["time"])
    way = last[0] - first[0], last[1] - first[1]
    swing = whole_swing(omega, slow, way, yaw, model.leg, rise + next_hold["rise"], next_hold["over"])
    decay = math.exp(-omega * slow.single)
    return x + decay * (last[0] + offset[0] - x) + swing[0], y + decay * (last[1] + offset[1] - y) + swing[1]


@njit(cache=True)
def _best_of_region(
    setup: Unboxed[_Setup],
    steps: Preview,
    step: _Underway,
    pace: Pace,
    measured: Vector,
    swing: SwingMotion,
    body: Body,
    corner: Point,
    room: Matrix,
    z: Vector,
) -> float:
    """``best_step`` of the present step in a region, in the stance frame; sets the nominal step in ``setup``.

    For ``steps`` see ``previewed_offset``, for ``corner`` see ``corner_between``. ``measured`` is the DCM in W
    (2,) [m], ``room`` bounds the foothold in the stance frame (2, 2) [m].
    """
    fixed, nominal = setup.record, setup.record.nominal
    model, motion = fixed.model, swing[0]
    foot, region, kept, ends, omega, elapsed, planned, soonest, latest, lead = step
    stance, next_hold = steps[0], steps[1]
    offset = previewed_offset(steps, foot, ends, omega, pace, model)
    swing_shift = rest_of_swing(omega, planned - elapsed, swing, body, model.leg)
    x, y, yaw = stance["x"], stance["y"], stance["yaw"]
    swing_place = relative_to(x, y, yaw, motion[0, 0], motion[0, 1])
    rounds, foot_limits = not math.isnan(corner[0]), fixed.passage.foot_limits
    moving, away = rotated(-yaw, motion[1, 0], motion[1, 1]), 0.0
    if rounds:
        away, moving = arrival(swing_place, moving, corner, foot_limits)
    stance_centre, centre = model.points[1 - foot], model.points[foot]
    point = point_at(x, y, yaw, stance_centre[0], stance_centre[1])
    landing = point_at(next_hold["x"], next_hold["y"], next_hold["yaw"], centre[0], centre[1])
    hold, zmp = relative_to(x, y, yaw, next_hold["x"], next_hold["y"]), relative_to(x, y, yaw, landing[0], landing[1])
    turned = rotated(-yaw, offset[0], offset[1])
    free = rotated(-yaw, measured[0] - point[0] - swing_shift[0], measured[1] - point[1] - swing_shift[1])
    reach = fixed.passage.reach[region, foot]
    dcm_free, end, lower, upper, place = np.empty(2), np.empty(2), np.empty(2), np.empty(2), np.empty(2)
    velocities = np.zeros((2, 2))
    for i in range(2):
        shift = zmp[i] - hold[i] - stance_centre[i]
        nominal.step[i], nominal.shift[i], nominal.offset[i] = hold[i] + shift, shift, offset[i]
        dcm_free[i], end[i] = free[i], turned[i]
        least, most = max(reach[0, i], room[0, i]), min(reach[1, i], room[1, i])
        if least > most:  # out of reach: the nearest point
            least = most = min(max(room[0, i], reach[0, i]), reach[1, i])
        lower[i], upper[i] = least + shift, most + shift
        at = corner[i] if rounds else swing_place[i]
        place[i] = at + shift
        nominal.dcm[i], nominal.place[i] = free[i], swing_place[i]
        # At a corner the foot may also pass slower.
        velocities[i, 0] = min(moving[i], 0.0) if rounds else moving[i]
        velocities[i, 1] = max(moving[i], 0.0) if rounds else moving[i]
    problem = StepProblem(
        dcm_free,
        elapsed,
        omega,
        nominal.step,
        max(pace.single, next_hold["time"]),
        end,
        offset_coupling(omega, with_single(pace, steps[min(2, len(steps) - 1)]["time"]), model),
        lower,
        upper,
        soonest,
        latest,
        fixed.cop[1 - foot],
        kept,
        place,
        velocities,
        elapsed + away + lead,
        foot_limits,
    )
    return best_step(problem, fixed.ending if ends else fixed.going_on, z)


@njit(cache=True)
def _judge(setup: Unboxed[_Setup], step: _Underway, z: Vector) -> tuple[Point, float]:
    """Corner that the straight path to a solution cuts, and distance by which the step after it misses the DCM [m]."""
    fixed, foot, omega = setup.record, step.foot, step.omega
    nominal, stance = fixed.nominal, 1 - step.foot
    place, target = nominal.place, z[:2] - nominal.shift
    corner = corner_between(foot, (place[0], place[1]), (target[0], target[1]), fixed.passage.corner)
    growth = math.exp(-omega * step.elapsed) * z[2]
    dcm = growth * nominal.dcm - (growth - 1.0) * z[3:] - z[:2]
    away = -z[:2]
    return corner, missed((dcm[0], dcm[1]), (away[0], away[1]), stance, fixed.half[foot], omega, fixed.passage)


@njit(cache=True)
def _foothold_of(
    setup: Unboxed[_Setup], steps: Preview, foot: int, omega: float, pace: Pace, step: Vector, end: Vector
) -> Point:
    """Foothold x, y in W [m] of a solution ``step``; sets ``end``, the DCM at its touchdown (2,) [m]."""
    model, nominal = setup.record.model, setup.record.nominal
    x, y, yaw = steps[0]["x"], steps[0]["y"], steps[0]["yaw"]
    slow = with_single(pace, steps[min(2, len(steps) - 1)]["time"])
    stance_centre, coupling = model.points[1 - foot], offset_coupling(omega, slow, model)
    point, way = point_at(x, y, yaw, stance_centre[0], stance_centre[1]), rotated(yaw, step[0], step[1])
    more = rotated(yaw, coupling * (step[0] - nominal.step[0]), coupling * (step[1] - nominal.step[1]))
    for i in range(2):
        end[i] = point[i] + way[i] + nominal.offset[i] + more[i]
    return point_at(x, y, yaw, step[0] - nominal.shift[0], step[1] - nominal.shift[1])
