"""Error of the elevation map of a walking robot, from its range sensors and its state estimate."""

import time
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import Benchmark, by_scenario, saved, settings
from benchmarks.core.harness import Case, Options, Report, chosen
from benchmarks.core.loops import start_walk
from bridge.analysis.plots import new_figure
from bridge.closed_loop import ClosedLoop
from bridge.plants.range_sensors import RayWorld, SimulatedDepthCamera, SimulatedLidar
from models.config import STRICT, NonNegative, Positive
from models.heading import heading, turned
from models.robot_model import RobotModel
from models.terrain import Ground, Terrain, terrain_named
from models.types import Matrix, Vector
from planners.gait.state import coming_steps

STEPS = 3  #: Number of coming steps whose area counts
_CASTS = 20  #: Number of depth pictures and lidar turns that are timed


@schema(frozen=True, slots=True, config=STRICT)
class TerrainMapBench:
    """Settings of the test; the units are in ``benchmarks/config/terrain_map.yaml``."""

    speed: Positive
    duration: Positive
    settle: Positive
    period: Positive
    before_fall: NonNegative
    margin: NonNegative
    patch_period: Positive
    scenarios: dict[str, str]
    goals: dict[str, str]


_config = partial(settings, TerrainMapBench, "terrain_map")


class Area:
    """Points of a sole with a margin, at a spacing of two centimetres, and estimated and true soles."""

    def __init__(self, robot: RobotModel, margin: float) -> None:
        self.robot, self._data = robot, robot.data()
        x_min, x_max, y_min, y_max = robot.feet[0].rectangle
        xs, ys = (np.arange(low - margin, high + margin, 0.02) for low, high in ((x_min, x_max), (y_min, y_max)))
        self._points = np.array([[x, y] for x in xs for y in ys])

    def ahead(self, loop: ClosedLoop) -> Matrix:
        """Return the points of the area of the next steps, from the estimate (n, 2) [m]."""
        steps = coming_steps(loop.gait.view, loop.gait.config)[:STEPS]
        return np.concatenate([np.zeros((0, 2)), *(turned(self._points, each.yaw) + each.pose[:2] for each in steps)])

    def sole(self, q: Vector, foot: int) -> tuple[Vector, float]:
        """Return position (3,) [m] and heading [rad] of a sole in a configuration (nq,)."""
        frame = self.robot.feet[foot].frame_id
        pin.forwardKinematics(self.robot.pin, self._data, q)
        place = pin.updateFramePlacement(self.robot.pin, self._data, frame)
        return place.translation.copy(), heading(*pin.Quaternion(place.rotation).coeffs())


def score(loop: ClosedLoop, ground: Ground, area: Area) -> Vector:
    """Return the error of the map at the points of the area of the next steps [m]; NaN for unknown points.

    Map and truth are relative to the stance sole, like a step on the map, so that errors of the odometry since the
    start do not count.
    """
    mapper, foot = loop.ground_view.mapper, loop.gait.stance
    points = area.ahead(loop)
    (estimate, yaw), (truth, true_yaw) = area.sole(loop.state.q, foot), area.sole(loop.truth.q, foot)
    heights = mapper.map.at(points) + mapper.reference - estimate[2]
    places = turned(points - estimate[:2], true_yaw - yaw) + truth[:2]
    errors: Vector = heights - (np.array([ground.height(x, y) for x, y in places]) - truth[2])
    return errors


def measure(robot: str, seed: int, scenario: str) -> Case:
    """Walk ahead and compare the map, until ``before_fall`` before a fall.

    ``squares`` is the mean squared error [m^2], NaN without comparisons; times are processor times of this machine [s].
    """
    config = _config()
    terrain = terrain_named({**config.scenarios, **config.goals}[scenario], seed=seed)
    loop = ClosedLoop(robot, seed=seed, terrain=terrain, terrain_map=True, record=False)
    view, area, ground = loop.ground_view, Area(loop.robot, config.margin), Ground(terrain)
    start_walk(loop, config.speed)
    start, patch_due, searches = loop.t, 0.0, []
    errors: list[tuple[float, Vector]] = []
    while loop.t - start < config.duration and not loop.fallen:
        loop.run(config.period)
        if loop.t - start < config.settle or loop.fallen:
            continue
        errors.append((loop.t, score(loop, ground, area)))
        if loop.t >= patch_due:
            patch_due, begin = loop.t + config.patch_period, time.thread_time()
            view.mapper.patches()
            searches.append(time.thread_time() - begin)
    end = loop.t - config.before_fall if loop.fallen else loop.t
    found = np.concatenate([np.zeros(0), *(each for t, each in errors if t <= end)])
    known = found[np.isfinite(found)]
    return {
        "fell": loop.fallen,
        "time": loop.t - start,
        "squares": float(np.mean(known**2)) if len(known) else float("nan"),
        "mean": float(np.mean(known)) if len(known) else float("nan"),
        "known": len(known) / max(len(found), 1),
        "points": len(found),
        "delay": max(view.delays),
        "updates": [float(np.percentile(costs, share)) for costs in view.costs.values() for share in (50, 99)],
        "patches": float(np.median(searches)) if searches else float("nan"),
        **cast_costs(loop.robot, terrain, loop.truth.q),
    }


def cast_costs(robot: RobotModel, terrain: Terrain, q: Vector) -> dict[str, float]:
    """Return the median processor time of a depth picture and of a lidar turn, including kinematics [s]."""
    world = RayWorld(robot, terrain)
    costs = {}
    for name, sensor in (("depth", SimulatedDepthCamera(world)), ("lidar", SimulatedLidar(world))):
        taken = []
        for _ in range(_CASTS):
            begin = time.thread_time()
            world.set(q)
            sensor.cloud(0.0)
            taken.append(time.thread_time() - begin)
        costs[name] = float(np.median(taken))
    return costs


class TerrainMap(Benchmark):
    """Each kind of ground once per seed."""

    measure = staticmethod(measure)

    def cases(self, options: Options) -> list[Case]:
        config = _config()
        known = [*config.scenarios, *config.goals]
        names = chosen("terrain_map", options.scenarios, known, list(config.scenarios))
        return [
            {"robot": options.robot, "seed": seed, "scenario": name} for name in names for seed in options.each_seed()
        ]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return RMSE of each ground and the worst [mm], least known share, largest delay and costs [ms], and falls."""
        figures, worst = {}, []
        for name, of in by_scenario(cases).items():
            worst.append(1e3 * float(np.max([case["squares"] for case in of])) ** 0.5)
            figures[f"rmse_{name}_mm"] = 1e3 * float(np.mean([case["squares"] for case in of])) ** 0.5
        return figures | {
            "rmse_worst_mm": float(np.max(worst)),
            "known_worst": min(case["known"] for case in cases),
            "delay_max_ms": 1e3 * max(case["delay"] for case in cases),
            "update_p99_ms": 1e3 * max(max(case["updates"]) for case in cases),
            "depth_ms": 1e3 * max(case["depth"] for case in cases),
            "lidar_ms": 1e3 * max(case["lidar"] for case in cases),
            "patches_ms": 1e3 * float(np.max([case["patches"] for case in cases])),
            "fell": float(sum(case["fell"] for case in cases)),
        }

    def notes(self, report: Report) -> list[str]:
        return super().notes(report) + [
            f"{case['scenario']}, seed {case['seed']}: fell after {case['time']:.1f} s; compared up to"
            f" {_config().before_fall:g} s before"
            for case in report.cases
            if case["fell"]
        ]

    def plots(self, report: Report, folder: Path) -> list[Path]:
        figure = new_figure(6.0, 3.0)
        axes = figure.add_subplot()
        for case in report.cases:
            axes.plot(case["scenario"], 1e3 * case["squares"] ** 0.5, "ko", markersize=4)
        axes.axhline(self.bounds(report)["rmse_worst_mm"].most, color="C3", linewidth=0.8, label="required")
        axes.set(ylabel="RMSE [mm]", ylim=(0.0, None), title=f"map ahead of a walk, {report.who}")
        axes.legend(fontsize=8, frameon=False)
        return [saved(figure, folder / f"terrain_map-{report.stem}.png")]
