"""Stairs of known geometry, walked without range sensors; stairs and stones that the robot sees."""

import math
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

_SETTLE = 4.0  #: After the footsteps, until the walk counts as stuck [s]
_PERIOD = 0.02  #: Of the requests for plans [s]
_BEHIND = 4.0  #: Level ground behind stairs [m]
_ROUNDING = 1e-6  #: Of the length of the ground [m]
_LOOK = 1.0  #: Before it walks around something [s]
_PLANS = 3  #: After so many plans the sensors are blind or shift, or a box appears
_BEYOND = 0.3  #: How far behind the last riser a walk on sight goes [m]


#: By ``amount`` [m] heights are seen too high, from the start until soles correct them (``high``) or from a later
#: plan on (``shift``); those of the map stay too high (``raised``); the map is too far ahead (``ahead``); its content
#: moves ahead in a second by whole cells (``drift``); a box appears so far ahead (``appears``). With ``blind`` nothing
#: is seen for so long [s]
Kind = Literal["high", "shift", "raised", "ahead", "drift", "blind", "appears"]


@schema(frozen=True, slots=True, config=STRICT)
class Fault:
    """A disturbance of what the robot sees."""

    kind: Kind
    amount: float


@schema(frozen=True, slots=True, config=STRICT)
class Flight:
    """Stairs, and where the robot has their geometry from."""

    rise: float  #: Of each step [m]
    seen: bool = False  #: By its own depth camera and lidar; else by its geometry
    given: bool = False  #: As a map, without sensors
    count: Annotated[int, Field(ge=0)] | None = None  #: Risers up, rows of stones or tiles; as all stairs when None
    gap: Positive | None = None  #: Between stones as long as a tread, of heights up to ``rise``; stairs when None [m]
    tile: Positive | None = None  #: Edge of tiles of heights up to ``rise``; stairs when None [m]
    box: tuple[Positive, Positive] | None = None  #: Length and width of a box of height ``rise``; on level ground [m]
    around: bool = False  #: The robot walks around what is in the way
    fault: Fault | None = None  #: Of its sight

    @property
    def mapped(self) -> bool:
        """Whether the robot plans its footsteps on a map."""
        return self.seen or self.given


@schema(frozen=True, slots=True, config=STRICT)
class StairsConfig:
    """The test; the unit of every value stands in ``benchmarks/config/stairs.yaml``."""

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
    """Climb and descend a flight of the settings, by its name (``climb_flight``)."""
    config = _config()
    return climb_flight({**config.rises, **config.required, **config.goals}[scenario], robot, seed)


def climb_flight(flight: Flight, robot: str, seed: int) -> Case:
    """Climb and descend one flight; ``distance`` is the way of the base, ``torque`` the largest share of a leg's limit.

    A walk survives when it does not fall, takes every footstep, and stands behind the stairs; where a box appears, when
    it stands in front of that with the reason.
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
    ended = ""
    start, x, gait = loop.t, float(loop.truth.q[0]), loop.gait
    if flight.mapped:
        distance = way + _BEYOND - float(loop.truth.q[0])
        if flight.around:
            ended = walk_around(loop, distance)
        else:
            sight = Sight(loop, flight.fault)
            ended = walk_on_sight(loop, distance, sight).outcome or f"under way after {config.limit:g} s"
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
    if flight.fault is not None and flight.fault.kind == "appears":  # it stands in front and says so
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
    }
    return outcome if outcome["survived"] else {**outcome, "moments": last_moments(loop, config.shown)}


def _ground(flight: Flight, config: StairsConfig, seed: int) -> tuple[Terrain, float]:
    """The terrain, and the place of its last edge along the way [m]."""
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
        length = way + config.tread + _ROUNDING  # one row of stones more
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
    """What a robot sees of the ground, with a fault."""

    def __init__(self, loop: ClosedLoop, fault: Fault | None = None) -> None:
        self._loop, self._kind, self._amount = loop, fault and fault.kind, fault.amount if fault else 0.0
        self._moved, self._begun = loop.t, math.inf
        if self._kind == "high":
            loop.ground_view.mapper.reset()
            loop.ground_view.mapper.bias = self._amount
        if self._kind == "appears":
            loop.plant.obstacle.remove()

    def ground(self) -> Heights:
        """The map of this moment."""
        ground = self._loop.ground_view.mapper.ground()
        x, y = ground.corner
        match self._kind:
            case "ahead":
                return ground._replace(corner=(x + self._amount, y))
            case "raised":
                return ground._replace(values=ground.values + self._amount)
        return ground

    def update(self, route: GroundRoute) -> None:
        """Move the map; after some plans the sensors are blind or shift, or a box appears."""
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


def _planner(loop: ClosedLoop) -> GroundPlanner:
    return GroundPlanner(loop.robot, loop.gait.config)


def walk_around(loop: ClosedLoop, distance: float) -> str:
    """Walk ahead over level ground [m], and beside what stands on it; empty, or why the robot cannot."""
    loop.run(_LOOK)
    here = middle(loop.gait.footholds)
    goal = Foothold(*here.moved(distance, 0.0), here.yaw, here.z)
    planner, request = _planner(loop), Request(0, GroundQuery(here, distance, loop.gait.footholds), around=True)
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
    """Walk straight ahead on the ground that the robot maps, over a distance [m]; or until it falls or is stuck."""
    sight = sight or Sight(loop)
    planner, route, config = _planner(loop), GroundRoute(loop.gait, loop.gait), _config()
    loop.run(_PERIOD)
    route.begin(middle(loop.gait.footholds), distance)
    latest, answers = loop.t + config.limit, list[tuple[float, Answer]]()
    while loop.t < latest and not loop.fallen and route.active:
        if (request := route.request(loop.t)) is not None:
            answer = answer_request(planner, request, sight.ground(), clearance=config.clearance)
            answers.append((loop.t + config.plan_delay, answer))
        while answers and answers[0][0] <= loop.t:
            route.answer(answers.pop(0)[1])
        sight.update(route)
        loop.run(_PERIOD)
    latest = loop.t + _SETTLE
    while loop.t < latest and not loop.fallen and not loop.gait.settled:
        loop.run(_PERIOD)
    return route


class StairsBench(SurvivalBenchmark):
    """The rises that have a bound, or those chosen, once a seed."""

    measure = staticmethod(climb)
    required_share, usual = _config().required_share, _config().rises
    required, goals = _config().required, _config().goals

    def further(self, name: str, cases: list[Case]) -> dict[str, float]:
        """The mean ``time_`` of the walks that survived [s], and all trips."""
        times = [case["time"] for case in cases if case["survived"]]
        mean = float(np.mean(times)) if times else float("nan")
        return {f"time_{name}_s": mean, f"trips_{name}": float(sum(case["trips"] for case in cases))}

    def notes(self, report: Report) -> list[str]:
        return super().notes(report) + [
            f"{case['scenario']}, seed {case['seed']}: {case['reason']} after {case['steps']} steps"
            for case in report.cases
            if not case["survived"]
        ]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        return draw_distances(report, folder, "distance [m]")
