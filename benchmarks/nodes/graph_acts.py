"""What is done to a running graph: to its processes, on its topics, to the machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context

from sensor_msgs.msg import JointState

from benchmarks.nodes import flood
from benchmarks.nodes.graph_stage import GraphStage
from bridge.ros.layout import BRIDGE, CONTROL, PLANNER, SUPERVISOR
from models.nodes import topics
from models.nodes.qos import SENSOR

FREEZE_TIME = 0.2
"""For which a process is stopped [s]."""

Act = Callable[[GraphStage], Iterator[float]]
"""Does something, then yields for how long the robot is to be watched before the next part [s]."""


def _kill(module: str) -> Act:
    def act(stage: GraphStage) -> Iterator[float]:
        os.kill(stage.graph.pids[module], signal.SIGKILL)
        yield from ()

    return act


def _freeze(module: str) -> Act:
    def act(stage: GraphStage) -> Iterator[float]:
        pid = stage.graph.pids[module]
        os.kill(pid, signal.SIGSTOP)
        try:
            yield FREEZE_TIME
        finally:
            os.kill(pid, signal.SIGCONT)

    return act


def _second_publisher(stage: GraphStage) -> Iterator[float]:
    publisher = stage.graph.node.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    try:
        yield 1.0
    finally:
        stage.graph.node.destroy_publisher(publisher)


@contextmanager
def _beside(target: Callable[..., None], count: int, *arguments: object) -> Iterator[None]:
    """Processes that run meanwhile."""
    processes = [get_context("spawn").Process(target=target, args=arguments, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()


def _flood(target: Callable[..., None], rate: float) -> Act:
    def act(stage: GraphStage) -> Iterator[float]:
        with _beside(target, 1, rate):
            yield flood.START_TIME + 2.0

    return act


def _starve(stage: GraphStage) -> Iterator[float]:
    """Twice as many processes as cores want all of the machine."""
    with _beside(flood.burn, 2 * multiprocessing.cpu_count()):
        yield flood.START_TIME + 2.0


def _fall_silent(stage: GraphStage) -> Iterator[float]:
    stage.user.walk(None)
    yield from ()


ACTS: dict[str, Act] = {
    "kill_control": _kill(CONTROL.module),
    "kill_planner": _kill(PLANNER.module),
    "kill_supervisor": _kill(SUPERVISOR.module),
    "kill_bridge": _kill(BRIDGE.module),
    "freeze_control": _freeze(CONTROL.module),
    "second_publisher": _second_publisher,
    "flood_texts": _flood(flood.texts, 10_000.0),
    "flood_services": _flood(flood.services, 1000.0),
    "fall_silent": _fall_silent,
    "starve": _starve,
}
"""By the name that a row gives them."""
