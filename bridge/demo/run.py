"""``poise demo``: a real-time run over ROS 2 of stand, wave, squat, push and walk, with a report."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from rich.console import Console

from bridge.analysis.plots import plot_run, plot_walk
from bridge.analysis.stability import stability_figures
from bridge.demo.report import Check, conclude, judge, judge_speed, judge_walk
from bridge.demo.stage import WALK, DemoConfig, SquareWalk, Stage, timed
from bridge.launch.graph import Graph
from bridge.record.recording import Recording
from bridge.record.render import render_filmstrip
from models.config import default_config
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.status import subscribe_status
from models.robot_model import RobotModel
from models.status import ControlStatus, MotionState, MotionStatus
from models.types import Mode


class Demo:
    """Plays the scenario on a running graph and records it; ``say`` is called with one line about each step."""

    def __init__(self, graph: Graph, model: RobotModel, config: DemoConfig, say: Callable[[str], object]) -> None:
        self._stage = Stage(graph, model, config, say)
        self._walk = SquareWalk(self._stage)
        self._motions: list[MotionStatus] = []
        subscribe_status(graph.node, MotionStatus, topics.MOTION_STATUS, self._motions.append)
        subscribe_status(graph.node, ControlStatus, topics.CONTROL_STATUS, self._on_control)
        self._ticks: list[tuple[float, float]] = []
        self._real_time_factor = float("nan")

    def play(self) -> None:
        """Play the whole scenario; a ``PoiseError`` names the step that failed."""
        stage, config = self._stage, self._stage.config
        stage.graph.wait_standing(config.start_limit)
        stage.watch(lambda: stage.observer.ready, config.start_limit, "no ground truth or no estimate was received")
        began = time.monotonic(), stage.observer.stamp
        stage.say(f"standing; quiet for {config.quiet_time:.0f} s")
        stage.pause(config.quiet_time)
        for name in config.motions:
            self._move(name)
            stage.pause(config.pause)
        stage.push(config.push_force, "push")
        stage.pause(config.recover_time)
        self._walk.play()
        self._real_time_factor = (stage.observer.stamp - began[1]) / (time.monotonic() - began[0])
        if stage.graph.mode != Mode.STAND.value:
            raise PoiseError(f"the robot does not stand at the end: mode '{stage.graph.mode}'")

    def recording(self) -> Recording:
        """Recording of the run so far."""
        return self._stage.observer.recording(self._stage.events)

    def close(self) -> None:
        """Stop observing."""
        self._stage.observer.close()

    def _on_control(self, status: ControlStatus) -> None:
        if np.isfinite(status.tick_median_us):
            self._ticks.append((status.tick_median_us, status.tick_tail_us))

    def speed_figures(self) -> dict[str, float]:
        """Median and worst tail of the controller's ticks [us], and ``real_time_factor``."""
        figures = {"real_time_factor": self._real_time_factor}
        if self._ticks:
            medians, tails = np.array(self._ticks).T
            figures |= {"tick_us_p50": float(np.median(medians)), "tick_us_p99": float(tails.max())}
        return figures

    def _move(self, name: str) -> None:
        stage = self._stage
        limit = stage.config.motion_limit
        self._motions.clear()
        stage.note(name)
        stage.graph.send(name)

        def ended() -> bool:
            for motion in self._motions:
                if motion.state in (MotionState.REFUSED, MotionState.ENDED):
                    raise PoiseError(f"{name} {motion}")
            done = any(motion.state is MotionState.DONE for motion in self._motions)
            return done and stage.graph.mode == Mode.STAND.value

        stage.watch(ended, limit, f"{name} did not end within {limit:.0f} s")
        stage.events.append((stage.observer.stamp, f"{name} done"))


def latency_figures(file: Path) -> dict[str, float]:
    """Figures of ``latency_file``: latencies [us] and ``missed_percent`` of the ticks; empty without the file."""
    if not file.is_file():
        return {}
    with np.load(file) as rows:
        published, received, skipped, active = (rows[name] for name in ("published", "received", "skipped", "active"))
    answered = active & (received > 0)
    if not answered.any():
        return {}
    latency = 1e-3 * (received[answered] - published[answered])
    p50, p99 = np.percentile(latency, [50.0, 99.0])
    lost = int(skipped[active].sum())
    return {
        "latency_us_p50": float(p50),
        "latency_us_p99": float(p99),
        "latency_us_max": float(latency.max()),
        "missed_percent": 100.0 * lost / (int(active.sum()) + lost),
    }


def demo(robot: str = "g1", out: Path = Path("out")) -> int:
    """Run the demonstration and write all files to ``out``; returns 0 when every check passed, otherwise 1."""
    console = Console()
    config = default_config(DemoConfig, "bridge", "demo")
    say = timed(console)
    model = RobotModel.load(robot)
    out.mkdir(parents=True, exist_ok=True)
    latency_file = (out / "latency.npz").resolve()
    latency_file.unlink(missing_ok=True)
    parameters = {"robot_driver": {"latency_file": str(latency_file), "push.duration": config.push_duration}}
    failure, recording = "", None
    fast: dict[str, float] = {}
    say(f"{model.name}: {model.nj} joints, {model.mass:.1f} kg; log: {out / 'graph.log'}")
    graph = Graph(robot, parameters=parameters, log=out / "graph.log", say=say)
    ending = ExitStack()  # the middleware is shut down last: it may block
    try:
        ending.enter_context(graph)
        played = Demo(graph, model, config, say)
        ending.callback(played.close)
        try:
            played.play()
        except PoiseError as error:
            failure = str(error)
        fast = played.speed_figures()
        recording = played.recording()
    except PoiseError as error:
        failure = failure or str(error)
    finally:
        graph.stop()
    crashed = {module: code for module, code in graph.exit_codes.items() if code != 0}
    if crashed and not failure:
        failure = "processes that did not end cleanly: " + ", ".join(
            f"{name} ({code})" for name, code in crashed.items()
        )
    checks = [Check("scenario", not failure, failure or "completed")]
    stable: dict[str, float] = {}
    fast |= latency_figures(latency_file)
    if recording is not None:
        standing, walking = recording.split(WALK)
        more, stability = judge(model, standing, config)
        stable = stability_figures(stability, config.pause)
        recording.save(out / "recording.npz")
        plots = plot_run(model, standing, stability, out / "plots")
        if walking is not None:
            walked, far = judge_walk(model, walking, config)
            more, stable = [*more, *walked], stable | far
            plots.append(plot_walk(model, walking, out / "plots"))
        else:
            more.append(Check(WALK, False, "did not happen"))
        checks += [*more, judge_speed(fast)]
        say("plots: " + ", ".join(str(file) for file in plots))
        problem = render_filmstrip(out / "recording.npz", out / "filmstrip.png", robot)
        say(problem or f"film strip: {out / 'filmstrip.png'}")
    return conclude(console, out, model.name, checks, stable, fast, ending)
