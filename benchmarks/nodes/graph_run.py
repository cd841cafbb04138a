"""Runs a graph under a scenario, in a process of its own, and gives back the rows of its processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist
from numpy.typing import NDArray

from benchmarks.latency_config import LatencyConfig, Scenario
from benchmarks.nodes.companions import companions
from benchmarks.process_use import Use, UseMeter
from bridge.launch import Graph
from bridge.ros.environment import free_domain
from bridge.ros.layout import CONTROL, REALTIME_NODES, process_specs
from bridge.ros.processes import ProcessSpec
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.qos import COMMAND
from models.nodes.realtime import die_with_parent

STAGED_CONTROL = ProcessSpec("benchmarks.nodes.staged_control", CONTROL.nodes)

VELOCITY_PERIOD = 0.05
"""Time between two walking velocities [s]."""

COMPANION_START = 3.0
"""In which companions import what they need and find the topics [s]."""


FAILED = "failed"
"""File that tells the graphs of a scenario why one of them has failed."""

LOOK_PERIOD = 0.1
"""Time between two looks at the other graphs [s]."""


@dataclass(frozen=True, slots=True)
class Run:
    """What one graph gave.

    Attributes:
        bridge: Rows of ``LatencyProbe``.
        laws: Rows of ``StageProbe``; empty where the stages were not noted.
        use: Of every process, companions included, by name.
    """

    bridge: dict[str, NDArray[Any]]
    laws: dict[str, NDArray[Any]]
    use: dict[str, Use]


def run_graphs(robot: str, seed: int, scenario: Scenario, config: LatencyConfig) -> list[Run]:
    """Run the graphs of a scenario at the same time, each in a process and a ROS domain of its own.

    Args:
        robot: Profile, by name or path.
        seed: Of the sensor noise of the first; the others have the ones after it.
        scenario: What goes on beside them.
        config: For how long.

    Raises:
        PoiseError: A graph does not come up, or something ends that should not.
    """
    domains = [free_domain() for _ in range(scenario.robots)]
    with (
        TemporaryDirectory(prefix="poise_") as folder,
        ProcessPoolExecutor(scenario.robots, mp_context=get_context("spawn"), initializer=die_with_parent) as pool,
    ):
        futures = [
            pool.submit(_run, robot, seed + k, scenario, config, k, domain, Path(folder))
            for k, domain in enumerate(domains)
        ]
        return [future.result() for future in futures]


def _run(
    robot: str, seed: int, scenario: Scenario, config: LatencyConfig, index: int, domain: int, shared: Path
) -> Run:
    """One graph; it starts when the one before stands, and is measured from when all of them do."""
    try:
        return _stand_and_measure(robot, seed, scenario, config, index, domain, shared)
    except BaseException as error:
        (shared / FAILED).write_text(str(error), encoding="utf-8")  # nobody is to wait for it
        raise


def _stand_and_measure(
    robot: str, seed: int, scenario: Scenario, config: LatencyConfig, index: int, domain: int, shared: Path
) -> Run:
    """See ``_run``."""
    _wait_for_others(shared, index, index * config.start_limit, time.sleep)
    folder = shared / str(index)
    folder.mkdir()
    files = {name: folder / f"{name}.npz" for name in ("bridge", "laws")}
    parameters: dict[str, dict[str, object]] = {
        "mujoco_bridge": {
            "latency_file": str(files["bridge"]),
            "seed": seed,
            "sensor_rate": scenario.rate,
            "speed": scenario.speed,
        },
        "supervisor": {"sensor_rate": scenario.rate},
    }
    specs = process_specs(merged=True)
    if scenario.stages:
        specs[specs.index(CONTROL)] = STAGED_CONTROL
        parameters["state_estimator"] = {"latency_file": str(files["laws"])}
    if scenario.own_core:
        for name in REALTIME_NODES:
            parameters[name] = {**parameters.get(name, {}), "realtime.own_core": True}
    if index:  # two graphs of real-time processes would stop both for 50 ms every second
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
        meter = UseMeter({**{name.rpartition(".")[2]: pid for name, pid in graph.pids.items()}, **others})
        _drive(graph, scenario, config)
        use = meter.read()
    rows = [dict(np.load(files[name])) if files[name].exists() else {} for name in ("bridge", "laws")]
    return Run(rows[0], rows[1], use)


def _wait_for_others(shared: Path, count: int, timeout: float, spin: Callable[[float], None]) -> None:
    """Wait until so many graphs stand, and serve callbacks meanwhile.

    Raises:
        PoiseError: They do not within a time [s], or one of them has failed.
    """
    end = time.monotonic() + timeout
    while (stand := len(list(shared.glob("stands_*")))) < count:
        if (shared / FAILED).exists():
            raise PoiseError((shared / FAILED).read_text(encoding="utf-8"))
        if time.monotonic() > end:
            raise PoiseError(f"{stand} of {count} graphs stand after {timeout:.0f} s")
        spin(LOOK_PERIOD)


def _drive(graph: Graph, scenario: Scenario, config: LatencyConfig) -> None:
    """Let the robot stand, or walk on, for the time that is measured."""
    duration = config.duration + config.warm_up
    if not scenario.walk:
        graph.spin(duration)
        return
    publisher = graph.node.create_publisher(Twist, topics.CMD_VEL, COMMAND)
    velocity = Twist()
    velocity.linear.x = config.walk_speed
    end = time.monotonic() + duration
    while time.monotonic() < end:
        publisher.publish(velocity)
        graph.spin(VELOCITY_PERIOD)
