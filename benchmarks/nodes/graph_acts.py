"""What is done to a running graph: to its processes, on its topics, to the machine."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from benchmarks.nodes import flood
from benchmarks.nodes.graph_command_acts import replayed, stand_while_walking, two_commanders, unsigned
from benchmarks.nodes.graph_kinds import PRODDED_CONTROL, PRODDED_PLANNER
from benchmarks.nodes.graph_process_acts import Act, collect, freeze, kill, reactivate, shift_wall_clock, throw
from benchmarks.nodes.graph_stage import LOOK, GraphStage
from bridge.ros.layout import BRIDGE, CONTROL, ESTIMATOR, PLANNER, SUPERVISOR
from models.nodes import topics
from models.nodes.qos import EVENT, SENSOR

FREEZE_TIME = 0.2
"""For which a process is stopped that is not to be missed [s]."""

LONG_FREEZE_TIME = 1.0
"""For which one is stopped that is [s]."""

MISMATCH_TIME = 3.0
"""After which the checks before arming have seen it [s]."""

SPOILT_TIME, MOMENT = 1.0, 0.005
"""For which messages are spoilt [s]."""


def _second_publisher(stage: GraphStage) -> Iterator[float]:
    publisher = stage.graph.node.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    try:
        yield 1.0
    finally:
        stage.graph.node.destroy_publisher(publisher)


def _second_clock(stage: GraphStage) -> Iterator[float]:
    """Somebody else says that it is an hour later, half as often as the plant says what time it is."""
    publisher = stage.graph.node.create_publisher(Clock, topics.CLOCK, SENSOR)
    message = Clock()
    message.clock.sec = 3600
    try:
        for _ in range(round(1.0 / LOOK)):
            publisher.publish(message)
            yield LOOK
    finally:
        stage.graph.node.destroy_publisher(publisher)


def _mismatch(stage: GraphStage) -> Iterator[float]:
    """While the robot is damped, somebody publishes a latched topic without keeping it for those who come later."""
    stage.ask("estop")
    publisher = stage.graph.node.create_publisher(String, topics.DRIVER_STATE, EVENT)
    try:
        stage.ask("reset_faults")
        yield MISMATCH_TIME
    finally:
        stage.graph.node.destroy_publisher(publisher)


def _spoil(topic: str, spoil: str, duration: float = SPOILT_TIME) -> Act:
    def act(stage: GraphStage) -> Iterator[float]:
        stage.spoil(topic, spoil, duration)
        yield duration

    return act


def _estop(stage: GraphStage) -> Iterator[float]:
    stage.ask("estop")
    yield from ()


def _nothing(stage: GraphStage) -> Iterator[float]:
    yield from ()


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


_JOINT_SPOILS = ("reordered", "missing", "extra", "duplicate", "repeated", "backward", "old", "future")

ACTS: dict[str, Act] = {
    "nothing": _nothing,
    "kill_control": kill(CONTROL.module),
    "kill_planner": kill(PLANNER.module),
    "kill_supervisor": kill(SUPERVISOR.module),
    "kill_bridge": kill(BRIDGE.module),
    "kill_estimator": kill(ESTIMATOR.module),
    "freeze_control": freeze(CONTROL.module, FREEZE_TIME),
    "freeze_bridge": freeze(BRIDGE.module, FREEZE_TIME),
    "freeze_bridge_long": freeze(BRIDGE.module, LONG_FREEZE_TIME),
    "throw_in_control": throw(PRODDED_CONTROL.module),
    "throw_in_planner": throw(PRODDED_PLANNER.module),
    "collect_garbage": collect(PRODDED_CONTROL.module),
    **{f"reactivate_{name}": reactivate(name) for name in (*CONTROL.nodes, *PLANNER.nodes, *SUPERVISOR.nodes)},
    **{f"joints_{spoil}": _spoil(topics.JOINT_STATES, spoil) for spoil in _JOINT_SPOILS},
    "joints_old_5ms": _spoil(topics.JOINT_STATES, "old", MOMENT),
    "joints_leaping": _spoil(topics.JOINT_STATES, "leaping"),
    "imu_unnormalised": _spoil(topics.IMU_RAW, "unnormalised"),
    "clock_silent": _spoil(topics.CLOCK, "silent"),
    "clock_hour_back": _spoil(topics.CLOCK, "hour_back"),
    "clock_hour_ahead": _spoil(topics.CLOCK, "hour_ahead"),
    "mismatch": _mismatch,
    "second_clock": _second_clock,
    "second_publisher": _second_publisher,
    "flood_texts": _flood(flood.texts, 10_000.0),
    "flood_services": _flood(flood.services, 1000.0),
    "fall_silent": _fall_silent,
    "two_commanders": two_commanders,
    "unsigned": unsigned,
    "replayed": replayed,
    "stand_while_walking": stand_while_walking,
    "estop": _estop,
    "starve": _starve,
    "wall_clock_ahead": shift_wall_clock(1.0),
    "wall_clock_back": shift_wall_clock(-1.0),
}
"""By the name that a row gives them."""
