"""Stairs of known geometry, walked without range sensors; stairs and stones mapped by the robot."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import SurvivalBenchmark, settings
from benchmarks.core.harness import Case, Report
from benchmarks.core.loops import demand
from benchmarks.stability.falls import draw_distances, last_moments
from bridge.closed_loop import ClosedLoop
from models.config import STRICT, NonNegative, Positive, Share
from models.terrain import Box, Terrain
from planners.gait.footsteps import Foothold, middle
from planners.gait.route import Footstep
from planners.terrain.elevation_map import Heights
from planners.terrain.footholds import GroundPlanner, GroundQuery
from planners.terrain.given_map import terrain_heights
from planners.terrain.ground_route import Answer, GroundRoute, Request, answer_request
from planners.terrain.stairs import Stairs, stair_footsteps

_SETTLE = 4.0  #: Time after the footsteps from which the walk counts as stuck [s]
_PERIOD = 0.02  #: Period of the requests for plans [s]
_BEHIND = 4.0  #: Length of the level ground behind stairs [m]
_ROUNDING = 1e-6  #: Rounding tolerance of the length of the ground [m]
_LOOK = 1.0  #: Time for observation before a detour [s]
_PLANS = 3  #: Number of plans after which the sensors are blind or shift, or a box appears
_BEYOND = 0.3  #: Distance of the end of a walk on sight behind the last riser [m]


#: ``high``: measured heights are too high by ``amount`` [m] from the start, until soles correct them; ``shift``: from a
#: later plan on. ``raised``: the heights of the map stay too high [m]. ``ahead``: the map is too far ahead [m].
#: ``drift``: its content moves ahead by whole cells [m/s]. ``appears``: a box appears this far ahead [m].
#: ``blind``: nothing is measured for this time [s]
Kind = Literal["high", "shift", "raised", "ahead", "drift", "blind", "appears"]


@schema(frozen=True, slots=True, config=STRICT)
class Fault:
    """Disturbance of the perception of the robot."""

    kind: Kind
    amount: float


@schema(frozen=True, slots=True, config=STRICT)
class Flight:
    """Stairs or other ground, and the source of their geometry for the robot."""

    rise: float  #: Height of each step [m]
    seen: bool = False  #: Whether depth camera and lidar map the ground; otherwise its geometry is known
    given: bool = False  #: Whether the ground is given as a map, without sensors
    count: Annotated[int, Field(ge=0)] | None = None  #: Risers up, rows of stones or tiles; None: ``count`` of the test
    gap: Positive | None = None  #: Gap between stones as long as a tread, heights up to ``rise``; stairs when None [m]
    tile: Positive | None = None  #: Edge length of tiles of heights up to ``rise``; stairs when None [m]
    box: tuple[Positive, Positive] | None = None  #: Length and width of a box of height ``rise`` on level ground [m]
    around: bool = False  #: Whether the robot walks around the box
    fault: Fault | None = None  #: Disturbance of the perception

    @property
    def mapped(self) -> bool:
        """Whether the robot plans its footsteps on a map."""
        return self.seen or self.given


@schema(frozen=True, slots=True, config=STRICT)
class StairsConfig:
    """Settings of the test; the units are in ``benchmarks/config/stairs.yaml``."""

    required_share: Share
    tread: Positive
    count: Annotated[int, Field(ge=1)]
    landing: Positive
    stride: Positive
    together: bool
    record_period: Positive
    shown: Positive
    seen_ahead: Positive
    limit: Positive
    plan_delay: NonNegative
    clearance: Positive
    rises: dict[str, Flight]
    required: dict[str, Flight]
    goals: dict[str, Flight]


_config = partial(settings, StairsConfig, "stairs")


def climb(robot: str, seed: int, scenario: str) -> Case:
    """Climb and descend a flight of the settings, given its name (``climb_flight``)."""
    config = _config()
    return climb_flight({**config.rises, **config.required, **config.goals}[scenario], robot, seed)


def climb_flight(flight: Flight, robot: str, seed: int) -> Case:
    """Climb and descend one flight; ``distance`` of the base [m], ``torque``: largest share of a leg's limit.

    A walk survives if it does not fall, takes every footstep, and stands behind the stairs. If a box appears, it
    survives if it stands in front of the box and reports the reason.
    """
    config = _config()
    terrain, way = _ground(flight, config, seed)
    loop = ClosedLoop(
        robot,
        seed=seed,
        terrain=terrain,
        terrain_map=flight.seen,
        given_map=terrain_heights(terrain) if flight.given else None,
        record_period_s=config.record_period,
    )
    demand(loop, "walk")
    ended, plan_times = "", list[float]()
    start, x, gait = loop.t, float(loop.truth.q[0]), loop.gait
    if flight.mapped:
        distance = way + _BEYOND - float(loop.truth.q[0])
        if flight.around:
            ended = walk_around(loop, distance)
        else:
            sight = Sight(loop, flight.fault)
            ended = walk_on_sight(loop, distance, sight).outcome or f"not arrived after {config.limit:g} s"
            plan_times = sight.plan_times
    else:
        loop.run(0.2)
        here = middle(gait.footholds)
        stairs = Stairs(
            terrain.patch - here.x,
            flight.rise,
            config.tread,
            terrain.count or config.count,
            config.landing,
            2.0 * terrain.width,
        )
        _take(
            loop,
            stair_footsteps(stairs, here, loop.robot, gait.config, stride=config.stride, together=config.together),
        )
    arrived = float(loop.truth.q[0]) > way
    done = gait.route.outcome == "done" and gait.settled and arrived
    if flight.fault is not None and flight.fault.kind == "appears":  # it stands in front of the box and reports it
        done = gait.settled and not arrived and "higher" in ended
    legs = [joint - 6 for foot in loop.robot.feet for joint in foot.joint_ids_v]
    outcome: Case = {
        "fell": loop.fallen,
        "reason": loop.fall_reason or "; ".join(loop.faults) or ("" if done else ended or "did not arrive"),
        "time": loop.t - start,
        "distance": float(loop.truth.q[0]) - x,
        "steps": gait.steps,
        "survived": not loop.fallen and done,
        "trips": gait.trips,
        "foot_slip": float(loop.foot_slip.max()),
        "torque": float((np.abs(loop.log.tau[:, legs]) / loop.robot.tau_max[legs]).max()),
        "plan_times": plan_times,
    }
    return outcome if outcome["survived"] else {**outcome, "moments": last_moments(loop, config.shown)}


def _ground(flight: Flight, config: StairsConfig, seed: int) -> tuple[Terrain, float]:
    """The terrain, and the position of its last edge along the way [m]."""
    count = config.count if flight.count is None else flight.count
    patch = config.seen_ahead if flight.mapped else Terrain("flat").patch
    if flight.box is not None:
        length, width = flight.box
        box = Box((length, width, flight.rise), (patch + 0.5 * length, 0.0))
        return Terrain("flat", patch=patch, obstacle=box), patch + length
    if flight.tile is not None:
        way = patch + count * flight.tile
        return Terrain("tiles", flight.rise, flight.tile, patch=patch, length=way + _BEHIND, seed=seed), way
    if flight.gap is not None:
        way = patch + count * (config.tread + flight.gap) + flight.gap
        length = way + config.tread + _ROUNDING  # one more row of stones
        return Terrain("stones", flight.rise, config.tread, flight.gap, patch=patch, length=length, seed=seed), way
    way = patch + 2.0 * (count - 1) * config.tread + config.landing
    terrain = Terrain("stairs", flight.rise, config.tread, count=count, landing=config.landing, patch=patch)
    return replace(terrain, length=way + _BEHIND), way


def _take(loop: ClosedLoop, steps: Sequence[Footstep]) -> None:
    """Take footsteps, until the robot stands, falls or is stuck."""
    gait = loop.gait
    gait.take_steps(steps)
    latest = loop.t + len(steps) * (gait.route.swing + gait.config.period) + _SETTLE
    loop.run(0.1)
    while loop.t < latest and not loop.fallen and (gait.route.left or not gait.settled):
        loop.run(0.1)


class Sight:
    """The robot's perception of the ground, with a fault.

    Attributes:
        plan_times: Processor time of each plan [s].
    """

    def __init__(self, loop: ClosedLoop, fault: Fault | None = None) -> None:
        self._loop, self._kind, self._amount = loop, fault and fault.kind, fault.amount if fault else 0.0
        self._moved, self._begun = loop.t, math.inf
        self._planner = GroundPlanner(loop.robot, loop.gait.config)
        self.plan_times: list[float] = []
        if self._kind == "high":
            loop.ground_view.mapper.reset()
            loop.ground_view.mapper.bias = self._amount
        if self._kind == "appears":
            loop.plant.obstacle.remove()

    def plan(self, request: Request) -> Answer:
        """Plan on the present map, with the fault."""
        ground, begin = self._ground(), time.thread_time()
        answer = answer_request(self._planner, request, ground, clearance=_config().clearance)
        self.plan_times.append(time.thread_time() - begin)
        return answer

    def _ground(self) -> Heights:
        ground = self._loop.ground_view.mapper.ground()
        x, y = ground.corner
        match self._kind:
            case "ahead":
                return ground._replace(corner=(x + self._amount, y))
            case "raised":
                return ground._replace(values=ground.values + self._amount)
        return ground

    def update(self, route: GroundRoute) -> None:
        """Shift the map; after some plans the sensors are blind or shift, or a box appears."""
        loop, grid = self._loop, self._loop.ground_view.mapper.map
        if self._kind == "drift" and loop.t - self._moved > grid.cell / self._amount:
            self._moved, grid.origin = loop.t, grid.origin + np.array([1, 0])
        if route.plans < _PLANS:
            return
        if self._begun == math.inf:
            self._begun = loop.t
            if self._kind == "appears":
                loop.plant.obstacle.place(float(loop.truth.q[0]) + self._amount, 0.0)
            elif self._kind == "shift":
                loop.ground_view.mapper.bias += self._amount
        loop.ground_view.blind = self._kind == "blind" and loop.t < self._begun + self._amount


def walk_around(loop: ClosedLoop, distance: float) -> str:
    """Walk a distance [m] ahead over level ground and around obstacles; returns why the robot cannot, or empty."""
    loop.run(_LOOK)
    here = middle(loop.gait.footholds)
    goal = Foothold(*here.moved(distance, 0.0), here.yaw, here.z)
    request = Request(0, GroundQuery(here, distance, loop.gait.footholds), around=True)
    planner = GroundPlanner(loop.robot, loop.gait.config)
    answer = answer_request(planner, request, loop.ground_view.mapper.ground(), clearance=_config().clearance)
    if answer.reason:
        return answer.reason
    for pose in (*answer.poses, goal):
        loop.gait.walk_to(pose)
        latest = loop.t + _config().limit
        while loop.t < latest and not loop.fallen and (loop.gait.route.left or not loop.gait.settled):
            loop.run(_PERIOD)
    return ""


def walk_on_sight(loop: ClosedLoop, distance: float, sight: Sight | None = None) -> GroundRoute:
    """Walk a distance [m] straight ahead on the mapped ground, until it is done, the robot falls or is stuck."""
    sight = sight or Sight(loop)
    route, config = GroundRoute(loop.gait, loop.gait), _config()
    loop.run(_PERIOD)
    route.begin(middle(loop.gait.footholds), distance)
    latest, answers = loop.t + config.limit, list[tuple[float, Answer]]()
    while loop.t < latest and not loop.fallen and route.active:
        if (request := route.request(loop.t)) is not None:
            answers.append((loop.t + config.plan_delay, sight.plan(request)))
        while answers and answers[0][0] <= loop.t:
            route.answer(answers.pop(0)[1])
        sight.update(route)
        loop.run(_PERIOD)
    latest = loop.t + _SETTLE
    while loop.t < latest and not loop.fallen and not loop.gait.settled:
        loop.run(_PERIOD)
    return route


class StairsBench(SurvivalBenchmark):
    """The rises that have a bound, or the chosen ones, once per seed."""

    measure = staticmethod(climb)
    required_share, usual = _config().required_share, _config().rises
    required, goals = _config().required, _config().goals

    def further(self, name: str, cases: list[Case]) -> dict[str, float]:
        """Mean ``time_`` of the walks that survived [s], number of trips, and processor time of the plans [ms]."""
        times = [case["time"] for case in cases if case["survived"]]
        mean = float(np.mean(times)) if times else float("nan")
        found = {f"time_{name}_s": mean, f"trips_{name}": float(sum(case["trips"] for case in cases))}
        if plans := [1e3 * each for case in cases for each in case.get("plan_times", ())]:
            median, most = np.percentile(plans, (50, 99)).tolist()
            found |= {f"plan_median_{name}_ms": median, f"plan_p99_{name}_ms": most, f"plan_max_{name}_ms": max(plans)}
        return found

    def notes(self, report: Report) -> list[str]:
        return super().notes(report) + [
            f"{case['scenario']}, seed {case['seed']}: {case['reason']} after {case['steps']} steps"
            for case in report.cases
            if not case["survived"]
        ]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        return draw_distances(report, folder, "distance [m]")
