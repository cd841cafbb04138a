"""Run graphs under a scenario, each in a process with its companion processes, and return the recorded rows."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import NonNegativeInt, PositiveInt
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import settings
from benchmarks.core.machine import Use, UseMeter
from benchmarks.graph.graph_kinds import User
from bridge.launch.graph import Graph
from bridge.launch.layout import CONTROL, process_specs
from bridge.launch.parameters import REALTIME_NODES
from bridge.ros.environment import free_domain, graph_environment
from bridge.ros.processes import ProcessSpec
from models.config import STRICT, Positive, Share
from models.errors import PoiseError
from models.nodes.realtime import die_with_parent


@schema(frozen=True, slots=True, config=STRICT)
class Scenario:
    """Load beside the measured robot, and options of its graph."""

    rate: Positive = 1000.0  #: Rate of sensors and laws [Hz]; physics and drivers keep their rates
    stress: NonNegativeInt = 0  #: Number of busy processes, pinned to the last core
    subscribers: NonNegativeInt = 0  #: Number of additional processes that subscribe to every topic of the tick
    slow: NonNegativeInt = 0  #: Number of further subscribers with default QoS (depth 10) that sleep in their callbacks
    record: bool = False  #: Whether ``poise record`` runs
    view: bool = False  #: Whether ``poise view`` runs, without a browser
    sight: bool = False  #: Whether range sensors, terrain mapper and ground planner run
    walk: bool = False  #: Whether the robot walks instead of standing
    robots: PositiveInt = 1  #: Number of simultaneous graphs, each in a ROS domain; only the first uses SCHED_FIFO
    #: Simulated time over real time, reduced for more robots than the cores can run in real time [-]
    speed: Share = 1.0
    own_core: bool = False  #: Whether bridge and control each run on a separate core
    stages: bool = True  #: Whether the control process records the end of each stage


@schema(frozen=True, slots=True, config=STRICT)
class LatencyConfig:
    """Settings of the test; the units are in ``benchmarks/config/latency.yaml``."""

    duration: Positive
    floor_duration: Positive
    warm_up: Positive
    start_limit: Positive
    p50_bound: Positive
    p99_bound: Positive
    missed_bound: Positive
    walk_speed: Positive
    usual: tuple[str, ...]
    scenarios: dict[str, Scenario]


latency_config = partial(settings, LatencyConfig, "latency")

STOP_LIMIT = 15.0  # maximum wait for a companion to end; a recording completes its file [s]

_POISE = "from bridge.cli import app; app()"


@contextmanager
def companions(scenario: Scenario, domain_id: int, folder: Path) -> Iterator[dict[str, int]]:
    """Run the companion processes in a ROS domain; yields pid by name; ``PoiseError`` when one ends early."""
    commands = {
        **{f"stress_{k}": ["-c", "while True: pass"] for k in range(scenario.stress)},
        **{f"subscriber_{k}": ["-m", "benchmarks.graph.listener"] for k in range(scenario.subscribers)},
        **{f"slow_{k}": ["-m", "benchmarks.graph.listener", "slow"] for k in range(scenario.slow)},
    }
    if scenario.record:
        commands["record"] = ["-c", _POISE, "record", "--out", str(folder / "run.mcap")]
    if scenario.view:
        commands["view"] = ["-c", _POISE, "view", "--port", str(_free_port())]
    environment = {**os.environ, **graph_environment(domain_id=domain_id)}
    started: dict[str, subprocess.Popen[bytes]] = {}
    try:
        with (folder / "companions.log").open("wb") as log:
            for name, words in commands.items():
                started[name] = subprocess.Popen(
                    [sys.executable, *words],
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    start_new_session=True,
                    preexec_fn=die_with_parent,  # none survives when the command is killed
                )
                if name.startswith("stress"):
                    os.sched_setaffinity(started[name].pid, {max(os.sched_getaffinity(0))})
        yield {name: process.pid for name, process in started.items()}
        ended = [name for name, process in started.items() if process.poll() is not None]
        if ended:
            output = (folder / "companions.log").read_text(encoding="utf-8", errors="replace")[-500:]
            raise PoiseError(f"{', '.join(ended)} ended while the graph was measured: {output}")
    finally:
        for process in started.values():
            process.send_signal(signal.SIGINT)
        for process in started.values():
            try:
                process.wait(STOP_LIMIT)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


TIMED_CONTROL = ProcessSpec("benchmarks.graph.timed_control", CONTROL.nodes)

COMPANION_START = 3.0  # start time of companions: imports and discovery [s]

FAILED = "failed"  # file with the reason why a graph of the scenario failed
LOOK_PERIOD = 0.1  # period of the check of the other graphs [s]


@dataclass(frozen=True, slots=True)
class Run:
    """Rows of ``LatencyProbe``, active only while measured, and of ``StageProbe`` (empty without stages).

    ``use`` has every process by name.
    """

    bridge: dict[str, NDArray[Any]]
    laws: dict[str, NDArray[Any]]
    use: dict[str, Use]


def run_graphs(robot: str, seed: int, scenario: Scenario, config: LatencyConfig) -> list[Run]:
    """Run the graphs of a scenario in parallel, each in a process and ROS domain; ``PoiseError`` when one fails."""
    domains = [free_domain() for _ in range(scenario.robots)]
    with (
        TemporaryDirectory(prefix="poise_") as folder,
        ProcessPoolExecutor(scenario.robots, mp_context=get_context("spawn"), initializer=die_with_parent) as pool,
    ):
        futures = [
            pool.submit(_run, robot, seed + k, scenario, config, k, domain, Path(folder))
            for k, domain in enumerate(domains)
        ]
        for future in as_completed(futures):
            if (error := future.exception()) is not None:
                (Path(folder) / FAILED).write_text(str(error), encoding="utf-8")  # ends the wait of the others
        return [future.result() for future in futures]


def _run(
    robot: str, seed: int, scenario: Scenario, config: LatencyConfig, index: int, domain: int, shared: Path
) -> Run:
    """Run one graph; it starts after the previous one stands, and is measured when all stand."""
    _wait_for_others(shared, index, index * config.start_limit, time.sleep)
    folder = shared / str(index)
    folder.mkdir()
    files = {name: folder / f"{name}.npz" for name in ("bridge", "laws")}
    parameters: dict[str, dict[str, object]] = {
        "robot_driver": {
            "latency_file": str(files["bridge"]),
            "seed": seed,
            "sensor_rate": scenario.rate,
            "speed": scenario.speed,
            "real_time": "strict",
        },
        "supervisor": {"sensor_rate": scenario.rate},
    }
    specs = process_specs(terrain_map=scenario.sight)
    if scenario.stages:
        specs[specs.index(CONTROL)] = TIMED_CONTROL
        parameters["state_estimator"] = {"latency_file": str(files["laws"])}
    if scenario.own_core:
        for name in REALTIME_NODES:
            parameters[name] = {**parameters.get(name, {}), "realtime.own_core": True}
    if index:  # two graphs of real-time processes would both be throttled for 50 ms every second
        for name in REALTIME_NODES:
            parameters[name] = {**parameters.get(name, {}), "realtime.priority": 0}
    with ExitStack() as stack:
        graph = stack.enter_context(
            Graph(
                robot, domain_id=domain, parameters=parameters, specs=specs, log=folder / "log", say=lambda text: None
            )
        )
        graph.wait_standing(config.start_limit)
        others = stack.enter_context(companions(scenario, domain, folder))
        if others:
            graph.spin(COMPANION_START)
        if scenario.walk:
            graph.call("mode/walk")
        (shared / f"stands_{index}").touch()
        _wait_for_others(shared, scenario.robots, scenario.robots * config.start_limit, graph.spin)
        begin = time.monotonic_ns()
        meter = UseMeter({**{name.rpartition(".")[2]: pid for name, pid in graph.pids.items()}, **others})
        if scenario.walk:
            User(graph).walk(config.walk_speed)
        graph.spin(config.duration + config.warm_up)
        use, end = meter.read(), time.monotonic_ns()
    rows = [dict(np.load(files[name])) if files[name].exists() else {} for name in ("bridge", "laws")]
    return Run(active_within(rows[0], begin, end), rows[1], use)


def active_within(rows: dict[str, NDArray[Any]], begin: int, end: int) -> dict[str, NDArray[Any]]:
    """Clear ``active`` of rows of ``LatencyProbe`` published outside of a span of the monotonic clock [ns]."""
    if not rows:
        return rows
    return rows | {"active": rows["active"] & (rows["published"] >= begin) & (rows["published"] <= end)}


def _wait_for_others(shared: Path, count: int, timeout: float, spin: Callable[[float], None]) -> None:
    """Spin until ``count`` graphs stand; ``PoiseError`` after ``timeout`` [s] or when a graph fails."""
    end = time.monotonic() + timeout
    while (stand := len(list(shared.glob("stands_*")))) < count:
        if (shared / FAILED).exists():
            raise PoiseError((shared / FAILED).read_text(encoding="utf-8"))
        if time.monotonic() > end:
            raise PoiseError(f"{stand} of {count} graphs stand after {timeout:.0f} s")
        spin(LOOK_PERIOD)
