"""Acts of rows of ``poise bench graph_faults``, on processes, topics, the machine and commands."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from benchmarks.graph import flood
from benchmarks.graph.graph_kinds import FAULTY_CONTROL, FAULTY_PLANNER, LOOK, GraphStage, User
from bridge.launch.layout import BRIDGE, CONTROL, ESTIMATOR, PLANNER, SUPERVISOR
from bridge.ros.lifecycle import ACTIVATE, DEACTIVATE, change_state
from controllers.commands.command_signature import Signer, read_key
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.qos import EVENT, SENSOR
from models.nodes.spin import SPIN_TIMEOUT

#: Performs an act in parts; yields the observation time after each part [s]
Act = Callable[[GraphStage], Iterator[float]]
TRANSITION_TIME = 20.0  # maximum wait for a state change of a node [s]
COLLECTIONS, COLLECTION_PERIOD = 10, 0.2  # number of garbage collections, and their period [s]
HOUR = 3600.0  # jump of a wall clock [s]


def once(do: Callable[[GraphStage], object]) -> Act:
    """Return an act with one part."""

    def act(stage: GraphStage) -> Iterator[float]:
        do(stage)
        yield from ()

    return act


def kill(module: str, number: signal.Signals = signal.SIGKILL) -> Act:
    """Send a signal to a process; SIGKILL acts like the kernel when memory runs out."""
    return once(lambda stage: os.kill(stage.graph.pids[module], number))


def freeze(module: str, duration: float) -> Act:
    """Suspend a process for a time [s]."""

    def act(stage: GraphStage) -> Iterator[float]:
        pid = stage.graph.pids[module]
        os.kill(pid, signal.SIGSTOP)
        try:
            yield duration
        finally:
            os.kill(pid, signal.SIGCONT)

    return act


def collect_garbage(stage: GraphStage) -> Iterator[float]:
    """Make the control process collect garbage several times."""
    for _ in range(COLLECTIONS):
        os.kill(stage.graph.pids[FAULTY_CONTROL.module], signal.SIGUSR1)
        yield COLLECTION_PERIOD


def reactivate(name: str) -> Act:
    """Deactivate and activate a node with its lifecycle services."""

    def act(stage: GraphStage) -> Iterator[float]:
        for transition in (DEACTIVATE, ACTIVATE):
            change_state(stage.graph.node, lambda: stage.graph.spin(0.02), [name], transition, TRANSITION_TIME)
            yield 1.0

    return act


def shift_wall_clock(hours: float) -> Act:
    """Shift the wall clock of every process of the graph and shift it back."""

    def act(stage: GraphStage) -> Iterator[float]:
        if (clock := stage.made.wall_clock) is None:
            raise ValueError("the wall clock of this graph cannot be shifted")
        clock.shift(hours * HOUR)
        yield 2.0
        if abs(stage.wall_lead - hours * HOUR) > 1.0:
            raise PoiseError(
                f"the wall clock of the processes is {stage.wall_lead:.1f} s off, not {hours * HOUR:.1f} s"
            )
        clock.shift(0.0)

    return act


WATCH = 3.0  # observation time after commands [s]


def two_commanders(stage: GraphStage) -> Iterator[float]:
    """Command zero velocity as ``teleop`` and a text as ``autonomy`` while ``plain`` commands a walk."""
    _, velocity = topics.source_topics("teleop")
    teleop = User(stage.graph, velocity)
    teleop.walk(0.0)
    with _publisher(stage, String, topics.source_topics("autonomy")[0], EVENT) as autonomy:
        yield 1.0
        autonomy.publish(String(data="forward"))
        yield WATCH
        teleop.walk(None)


def unsigned(stage: GraphStage) -> Iterator[float]:
    """Send texts and velocities without signature."""
    stage.graph.send("wave")
    stage.user.walk(0.3)
    yield 1.0
    stage.user.walk(None)


def replayed(stage: GraphStage) -> Iterator[float]:
    """Send a modified signed command, a valid one, and the valid one again."""
    signed = Signer(read_key(stage.made.key), "teleop").sign("walk")
    stage.graph.send(signed.replace("walk", "wave"))
    yield SPIN_TIMEOUT
    stage.graph.send(signed)
    stage.graph.wait_for(lambda: stage.graph.mode == "walk", WATCH, "walking after a signed command")
    stage.ask("mode/stand")
    stage.graph.wait_for(lambda: stage.graph.mode == "stand", WATCH, "standing again")
    stage.graph.send(signed)
    yield WATCH


FREEZE_TIME = 0.2  # shorter than the timeouts [s]
LONG_FREEZE_TIME = 1.0  # longer than the timeouts [s]
MISMATCH_TIME = 3.0  # time after which the checks before arming have detected it [s]
CORRUPTION_TIME, MOMENT = 1.0, 0.005  # durations of corruption [s]


@contextmanager
def _publisher(stage: GraphStage, kind: type, topic: str, qos: Any) -> Iterator[Any]:
    publisher = stage.graph.node.create_publisher(kind, topic, qos)
    try:
        yield publisher
    finally:
        stage.graph.node.destroy_publisher(publisher)


def _second_publisher(stage: GraphStage) -> Iterator[float]:
    with _publisher(stage, JointState, topics.JOINT_STATES, SENSOR):
        yield 1.0


def _second_clock(stage: GraphStage) -> Iterator[float]:
    message = Clock()
    message.clock.sec = 3600
    with _publisher(stage, Clock, topics.CLOCK, SENSOR) as publisher:
        for _ in range(round(1.0 / LOOK)):
            publisher.publish(message)
            yield LOOK


def _mismatch(stage: GraphStage) -> Iterator[float]:
    """Add a volatile second publisher of a latched topic while the robot is damped."""
    stage.ask("estop")
    with _publisher(stage, String, topics.DRIVER_STATE, EVENT):
        stage.ask("reset_faults")
        yield MISMATCH_TIME


def _corrupt(topic: str, corruption: str, duration: float = CORRUPTION_TIME) -> Act:
    def act(stage: GraphStage) -> Iterator[float]:
        stage.corrupt(topic, corruption, duration)
        yield duration

    return act


@contextmanager
def _beside(target: Callable[..., None], count: int, *arguments: object) -> Iterator[None]:
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
    with _beside(flood.burn, 2 * multiprocessing.cpu_count()):
        yield flood.START_TIME + 2.0


_JOINT_CORRUPTIONS = ("reordered", "missing", "extra", "duplicate", "repeated", "backward", "old", "future")

ACTS: dict[str, Act] = {
    "nothing": once(lambda stage: None),
    "kill_control": kill(CONTROL.module),
    "kill_planner": kill(PLANNER.module),
    "kill_supervisor": kill(SUPERVISOR.module),
    "kill_bridge": kill(BRIDGE.module),
    "kill_estimator": kill(ESTIMATOR.module),
    "freeze_control": freeze(CONTROL.module, FREEZE_TIME),
    "freeze_bridge": freeze(BRIDGE.module, FREEZE_TIME),
    "freeze_bridge_long": freeze(BRIDGE.module, LONG_FREEZE_TIME),
    "throw_in_control": kill(FAULTY_CONTROL.module, signal.SIGUSR2),
    "throw_in_planner": kill(FAULTY_PLANNER.module, signal.SIGUSR2),
    "collect_garbage": collect_garbage,
    **{f"reactivate_{name}": reactivate(name) for name in (*CONTROL.nodes, *PLANNER.nodes, *SUPERVISOR.nodes)},
    **{f"joints_{each}": _corrupt(topics.JOINT_STATES, each) for each in _JOINT_CORRUPTIONS},
    "joints_old_5ms": _corrupt(topics.JOINT_STATES, "old", MOMENT),
    "joints_jumping": _corrupt(topics.JOINT_STATES, "jumping"),
    "imu_unnormalised": _corrupt(topics.IMU_RAW, "unnormalised"),
    "clock_silent": _corrupt(topics.CLOCK, "silent"),
    "clock_hour_back": _corrupt(topics.CLOCK, "hour_back"),
    "clock_hour_ahead": _corrupt(topics.CLOCK, "hour_ahead"),
    "mismatch": _mismatch,
    "second_clock": _second_clock,
    "second_publisher": _second_publisher,
    "flood_texts": _flood(flood.texts, 10_000.0),
    "flood_services": _flood(flood.services, 1000.0),
    "fall_silent": once(lambda stage: stage.user.walk(None)),
    "two_commanders": two_commanders,
    "unsigned": unsigned,
    "replayed": replayed,
    "stand_while_walking": once(lambda stage: stage.ask("mode/stand")),
    "estop": once(lambda stage: stage.ask("estop")),
    "starve": _starve,
    "wall_clock_ahead": shift_wall_clock(1.0),
    "wall_clock_back": shift_wall_clock(-1.0),
}
