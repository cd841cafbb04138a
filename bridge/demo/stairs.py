"""``poise demo --scene stairs``: over ROS 2, a robot climbs and descends a flight that it maps with its sensors."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from nav_msgs.msg import Path as Footsteps
from pydantic.dataclasses import dataclass
from rich.console import Console
from std_msgs.msg import UInt8MultiArray

from bridge.analysis.plots import new_figure
from bridge.analysis.processor import cpu_time
from bridge.demo.report import CPU, Check, conclude, fell, judge_speed
from bridge.demo.stage import DemoConfig, Stage, Walk, timed
from bridge.launch.graph import Graph
from bridge.launch.layout import process_specs
from bridge.record.recording import Recording
from bridge.record.render import render_filmstrip
from models.config import STRICT, Positive, default_config
from models.errors import PoiseError
from models.heading import heading, turned
from models.nodes import topics
from models.nodes.grid_map import grid_map_type
from models.nodes.messages import stamp_ns, to_seconds
from models.nodes.qos import EVENT, SENSOR
from models.robot_model import SOLE_FRAMES, RobotModel
from models.status import RouteState
from models.terrain import Ground, Terrain, terrain_named
from models.types import Matrix, Vector
from planners.gait.footsteps import Foothold
from planners.nodes.footstep_messages import foothold_from_pose, pose_message
from planners.nodes.gait_link import decode
from planners.nodes.ground_planner import ground_from_message
from planners.terrain.elevation_map import Heights
from planners.terrain.ground_route import Answer

_LIES = 0.03  #: Largest distance of a point of a sole from the ground that it lies on; soles land tilted [m]
_DOUBLE = 0.15  #: Time after the last touchdown up to which a plan counts as from before lift-off, approximate [s]
_SPACING = 0.02  #: Spacing of the points of a sole at which map and ground are compared [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class StairsScene:
    """Place and pass criteria; see ``bridge/config/demo_stairs.yaml``."""

    terrain: str
    behind: Positive
    map_limit: Positive
    walk_limit: Positive
    map_error: Positive
    latency: Positive
    foothold_error: Positive


class Landing(NamedTuple):
    """A touchdown, with the foothold and the map that were known before lift-off."""

    t: float  #: Stamp [s]
    foot: int
    error: tuple[float, float]  #: Error of the sole from its planned foothold, along and across [m]
    lies: bool  #: Whether the whole sole is truly on the ground
    sole: Vector  #: True position of the sole (3,) [m]
    planned: float  #: Height of the map under the sole in W, relative to the true stance sole [m]
    errors: Vector  #: Height errors of the map under the sole, relative to the stance sole (n,) [m]


class StairsWalk(Walk):
    """Walks to a goal behind the stairs, and records maps and footsteps."""

    def __init__(self, stage: Stage, scene: StairsScene) -> None:
        super().__init__(stage)
        self._scene, node = scene, stage.graph.node
        self.maps: list[Any] = []
        self.planned: list[Footsteps] = []
        self.taken: list[tuple[float, Any]] = []  # stamp [s] and pose of each touchdown
        self.delays: list[float] = []  # latency from light to the footholds planned on it [s]
        node.create_subscription(UInt8MultiArray, topics.GROUND_PLAN, self._on_plan, EVENT)
        node.create_subscription(grid_map_type(), topics.TERRAIN_MAP, self.maps.append, SENSOR)
        node.create_subscription(Footsteps, topics.FOOTSTEPS, self.planned.append, EVENT)
        node.create_subscription(Footsteps, topics.FOOTSTEPS_TAKEN, self._on_taken, EVENT)

    def play(self, distance: float) -> None:
        """Walk ahead by a distance [m] and stand. Raises ``PoiseError`` if the goal is refused or not reached."""
        stage, scene = self._stage, self._scene
        stage.watch(lambda: bool(self.maps), scene.map_limit, "no map of the ground was received")
        start = Foothold(*stage.observer.place)
        stage.graph.send("walk")
        self._begin()
        stage.note(f"goal {distance:.1f} m ahead")
        self._goals.publish(pose_message(Foothold(*start.moved(distance, 0.0), start.yaw), topics.ODOM_FRAME))
        ended = lambda: bool(self._routes) and self._routes[-1].state is not RouteState.RUNNING  # noqa: E731
        stage.watch(ended, scene.walk_limit, "the goal was not reached")
        if self._routes[-1].state is not RouteState.DONE:
            raise PoiseError(f"the walk to the goal {self._routes[-1]}")
        stage.note("arrived")
        self._stop()
        stage.pause(1.0)

    def _on_plan(self, message: UInt8MultiArray) -> None:
        answer = decode(Answer, message)
        if answer.steps:
            self._stage.observer.poll()
            self.delays.append(self._stage.observer.stamp - answer.stamp)

    def _on_taken(self, message: Footsteps) -> None:
        pose = message.poses[-1]
        self.taken.append((to_seconds(stamp_ns(pose.header.stamp)), pose))

    def landings(self, model: RobotModel, recording: Recording, ground: Ground) -> list[Landing]:
        """Touchdowns whose foothold and map were known before lift-off."""
        assert recording.estimate is not None
        maps = [(to_seconds(stamp_ns(each.header.stamp)), ground_from_message(each)) for each in self.maps]
        plans = [(to_seconds(stamp_ns(each.header.stamp)), each) for each in self.planned]
        found = []
        for (before, _), (t, taken) in zip(self.taken, self.taken[1:], strict=False):
            frame = taken.header.frame_id
            known = [plan for stamp, plan in plans if stamp <= before + _DOUBLE]
            seen = [heights for stamp, heights in maps if stamp <= before]
            poses = [pose for pose in (known[-1].poses if known else []) if pose.header.frame_id == frame]
            if not poses or not seen:
                continue
            landed = taken.pose.position
            i = int(np.searchsorted(recording.t, t).clip(0, len(recording.t) - 1))
            true = _soles(model, recording.q[i])
            estimate = _soles(model, np.concatenate([recording.estimate[i], recording.q[i, 7:]]))
            foot = SOLE_FRAMES.index(frame)
            places, rises = _under(model, foot, true, estimate, seen[-1])
            heights = np.array([ground.height(x, y) for x, y in places.tolist()])
            truth = heights - true[1 - foot].translation[2]
            hold = foothold_from_pose("planned", poses[0].pose)
            found.append(
                Landing(
                    t,
                    foot,
                    hold.relative(landed.x, landed.y),
                    bool((np.abs(heights - true[foot].translation[2]) < _LIES).all()),
                    true[foot].translation.copy(),
                    float(np.nanmean(rises) + true[1 - foot].translation[2]) if np.isfinite(rises).any() else np.nan,
                    rises - truth,
                )
            )
        return found


def _soles(model: RobotModel, q: Vector) -> list[pin.SE3]:
    data = model.data()
    pin.framesForwardKinematics(model.pin, data, q)
    return [data.oMf[foot.frame_id].copy() for foot in model.feet]


def _under(
    model: RobotModel, foot: int, true: Sequence[pin.SE3], estimate: Sequence[pin.SE3], heights: Heights
) -> tuple[Matrix, Vector]:
    """True positions under a sole (n, 2) [m], and their heights on the map above the other sole (n,) [m]."""
    x_min, x_max, y_min, y_max = model.feet[foot].rectangle
    points = np.array([(x, y) for x in np.arange(x_min, x_max, _SPACING) for y in np.arange(y_min, y_max, _SPACING)])

    def placed(sole: pin.SE3) -> Matrix:
        yaw = heading(*pin.Quaternion(sole.rotation).coeffs())
        places: Matrix = turned(points, yaw) + sole.translation[:2]
        return places

    return placed(true[foot]), heights.at(placed(estimate[foot])) - estimate[1 - foot].translation[2]


def judge_stairs(
    recording: Recording, landings: Sequence[Landing], delays: Sequence[float], scene: StairsScene, terrain: Terrain
) -> tuple[list[Check], dict[str, float]]:
    """Checks and figures of a walk over the flight, against the true ground; foothold errors by the estimate.

    ``delays`` are the latencies from a range measurement to the footholds planned on it [s].
    """
    heights = np.array([landing.sole[2] for landing in landings])
    errors = np.concatenate([np.zeros(0), *(landing.errors for landing in landings)])
    known = errors[np.isfinite(errors)]
    rmse = float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
    along, across = np.abs([landing.error for landing in landings]).max(axis=0) if landings else (np.nan, np.nan)
    beside = sum(not landing.lies for landing in landings)
    top = (terrain.count or 0) * terrain.height
    climbed = bool(len(heights) and heights.max() > top - 0.02 and abs(heights[-1]) < 0.02)
    delay, longest = (float(np.median(delays)), max(delays)) if delays else (np.nan, np.nan)
    fallen = fell(recording.q, recording.q[0, 2])
    duration = float(recording.t[-1] - recording.t[0])
    checks = [
        Check("flight", climbed and not fallen, f"{len(landings)} steps in {duration:.1f} s, up {heights.max():.2f} m")
        if len(heights)
        else Check("flight", False, "no step was taken"),
        Check("fall", not fallen, "fell" if fallen else "none"),
        Check("map", rmse < scene.map_error, f"RMSE {1e3 * rmse:.1f} mm under the soles before they land"),
        Check("soles", not beside, f"{beside} touchdowns with a part of the sole beside the ground"),
        Check(
            "footholds",
            bool(along < scene.foothold_error),
            f"largest error {1e2 * along:.1f} cm along the way, {1e2 * across:.1f} cm across (includes balance)",
        ),
        Check(
            "latency",
            longest < scene.latency,
            f"{1e3 * delay:.0f} ms from range measurement to footholds, largest {1e3 * longest:.0f} ms,"
            f" at most {1e3 * scene.latency:.0f} ms",
        ),
    ]
    figures = {
        "steps": float(len(landings)),
        "duration_s": duration,
        "map_rmse_m": rmse,
        "map_known": len(known) / max(len(errors), 1),
        "foothold_along_max_m": float(along),
        "foothold_across_max_m": float(across),
        "light_to_foothold_s_median": delay,
        "light_to_foothold_s_max": longest,
    }
    return checks, figures


def plot_stairs(recording: Recording, landings: Sequence[Landing], ground: Ground, file: Path) -> Path:
    """Plot flight, map and soles from the side, and the errors of each step."""
    figure = new_figure(9.0, 5.0)
    side, below = figure.subplots(2, 1, height_ratios=(2, 1))
    reach = float(recording.q[:, 0].max()) + 0.3
    along = np.arange(-0.3, reach, 0.005)
    side.plot(along, [ground.height(x, 0.0) for x in along.tolist()], color="0.6", linewidth=1.0, label="ground")
    for foot, (name, colour) in enumerate((("left", "#1b6ca8"), ("right", "#d1495b"))):
        own = [each for each in landings if each.foot == foot]
        x = [each.sole[0] for each in own]
        side.plot(x, [each.sole[2] for each in own], "_", color=colour, markersize=14, label=f"{name} sole")
        side.plot(x, [each.planned for each in own], "x", color=colour, markersize=4, label="... on its map")
    side.plot(recording.q[:, 0], recording.q[:, 2], color="0.3", linewidth=0.7, label="base")
    side.set(xlabel="x [m]", ylabel="z [m]")
    side.legend(fontsize=7, frameon=False, ncols=2)
    number = np.arange(len(landings))
    squares = [each.errors[np.isfinite(each.errors)] ** 2 for each in landings]
    rms = [1e3 * float(np.mean(each)) ** 0.5 if len(each) else np.nan for each in squares]
    below.plot(number, rms, "k.-", linewidth=0.7, label="map under the sole, RMSE [mm]")
    off = [1e3 * float(np.hypot(*each.error)) for each in landings]
    below.plot(number, off, ".-", color="#66a182", linewidth=0.7, label="sole from its foothold [mm]")
    below.set(xlabel="step", ylabel="error [mm]", ylim=(0.0, None))
    below.legend(fontsize=7, frameon=False)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    return file


def cpu_times(pids: Mapping[str, int]) -> dict[str, float]:
    """Processor time of each process so far [s], by the last part of its module name."""
    return {name.rpartition(".")[2]: cpu_time(pid) for name, pid in pids.items()}


def demo_stairs(robot: str, out: Path) -> int:
    """Climb and descend the flight, with all files in ``out``; returns 0 when every check passed, otherwise 1."""
    console = Console()
    say = timed(console)
    config = default_config(DemoConfig, "bridge", "demo")
    scene = default_config(StairsScene, "bridge", "demo_stairs")
    terrain = terrain_named(scene.terrain)
    way = terrain.patch + 2.0 * ((terrain.count or 1) - 1) * terrain.size + terrain.landing + scene.behind
    model = RobotModel.load(robot)
    out.mkdir(parents=True, exist_ok=True)
    parameters = {"robot_driver": {"terrain": scene.terrain}, "range_sensor_node": {"terrain": scene.terrain}}
    graph = Graph(robot, specs=process_specs(terrain_map=True), parameters=parameters, log=out / "graph.log", say=say)
    failure, recording, landings, delays = "", None, list[Landing](), list[float]()
    fast = {"real_time_factor": float("nan")}
    ending = ExitStack()  # the middleware is shut down last: it may block
    try:
        ending.enter_context(graph)
        stage = Stage(graph, model, config, say)
        ending.callback(stage.observer.close)
        walk = StairsWalk(stage, scene)
        try:
            graph.wait_standing(config.start_limit)
            stage.watch(lambda: stage.observer.ready, config.start_limit, "no ground truth or no estimate was received")
            began, used = (time.monotonic(), stage.observer.stamp), cpu_times(graph.pids)
            walk.play(way)
            passed = stage.observer.stamp - began[1]
            fast["real_time_factor"] = passed / (time.monotonic() - began[0])
            fast |= {f"{CPU}{name}": (end - used[name]) / passed for name, end in cpu_times(graph.pids).items()}
        except PoiseError as error:
            failure = str(error)
        recording = stage.observer.recording(stage.events)
        landings, delays = walk.landings(model, recording, Ground(terrain)), walk.delays
    except PoiseError as error:
        failure = failure or str(error)
    finally:
        graph.stop()
    checks = [Check("scenario", not failure, failure or "completed")]
    figures: dict[str, float] = {}
    if recording is not None:
        judged, figures = judge_stairs(recording, landings, delays, scene, terrain)
        checks += [*judged, judge_speed(fast)]
        recording.save(out / "recording.npz")
        say(f"plot: {plot_stairs(recording, landings, Ground(terrain), out / 'stairs.png')}")
        problem = render_filmstrip(out / "recording.npz", out / "filmstrip.png", robot, terrain=scene.terrain)
        say(problem or f"film strip: {out / 'filmstrip.png'}")
    return conclude(console, out, model.name, checks, figures, fast, ending)
