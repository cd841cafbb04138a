"""Acts of rows of ``poise bench graph_faults``: on processes, topics and the machine, and commands."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import get_context

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from benchmarks.graph import flood
from benchmarks.graph.graph_kinds import PRODDED_CONTROL, PRODDED_PLANNER
from benchmarks.graph.graph_stage import LOOK, GraphStage, User
from bridge.ros.processes import ACTIVATE, BRIDGE, CONTROL, DEACTIVATE, ESTIMATOR, PLANNER, SUPERVISOR, change_state
from controllers.commands.command_key import read_key
from controllers.commands.command_signature import Signer
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.qos import EVENT, SENSOR
from models.nodes.spin import SPIN_TIMEOUT

#: Does something, then yields for how long the robot is to be watched before the next part [s]
Act = Callable[[GraphStage], Iterator[float]]
TRANSITION_TIME = 20.0  # longest wait for a node to change its state [s]
COLLECTIONS, COLLECTION_PERIOD = 10, 0.2  # how often garbage is collected, and how long after the last time [s]
HOUR = 3600.0  # by which a wall clock jumps [s]


def kill(module: str) -> Act:
    """End a process as the kernel does when memory runs out."""

    def act(stage: GraphStage) -> Iterator[float]:
        os.kill(stage.graph.pids[module], signal.SIGKILL)
        yield from ()

    return act


def freeze(module: str, duration: float) -> Act:
    """Stop a process for a time [s]."""

    def act(stage: GraphStage) -> Iterator[float]:
        pid = stage.graph.pids[module]
        os.kill(pid, signal.SIGSTOP)
        try:
            yield duration
        finally:
            os.kill(pid, signal.SIGCONT)

    return act


def throw(module: str) -> Act:
    """Have a callback of a prodded process raise."""

    def act(stage: GraphStage) -> Iterator[float]:
        os.kill(stage.graph.pids[module], signal.SIGUSR2)
        yield from ()

    return act


def collect(module: str) -> Act:
    """Have a prodded process collect its garbage, several times."""

    def act(stage: GraphStage) -> Iterator[float]:
        for _ in range(COLLECTIONS):
            os.kill(stage.graph.pids[module], signal.SIGUSR1)
            yield COLLECTION_PERIOD

    return act


def reactivate(name: str) -> Act:
    """Deactivate a node and activate it again, by its lifecycle services."""

    def act(stage: GraphStage) -> Iterator[float]:
        for transition in (DEACTIVATE, ACTIVATE):
            change_state(stage.graph.node, lambda: stage.graph.spin(0.02), [name], transition, TRANSITION_TIME)
            yield 1.0

    return act


def shift_wall_clock(hours: float) -> Act:
    """Have the wall clock of every process of the graph jump, and jump back."""

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


WATCH = 3.0  # of commands after the act [s]


def two_commanders(stage: GraphStage) -> Iterator[float]:
    """While ``plain`` commands a walk, ``teleop`` commands zero velocity, and ``autonomy`` a text."""
    _, velocity = topics.source_topics("teleop")
    teleop = User(stage.graph, velocity)
    teleop.walk(0.0)
    autonomy = stage.graph.node.create_publisher(String, topics.source_topics("autonomy")[0], EVENT)
    yield 1.0
    autonomy.publish(String(data="forward"))
    yield WATCH
    teleop.walk(None)
    stage.graph.node.destroy_publisher(autonomy)


def unsigned(stage: GraphStage) -> Iterator[float]:
    """Words and velocities without a signature."""
    stage.graph.send("wave")
    stage.user.walk(0.3)
    yield 1.0
    stage.user.walk(None)


def replayed(stage: GraphStage) -> Iterator[float]:
    """A modified signed command, a valid one, and the same again."""
    signed = Signer(read_key(stage.made.key), "teleop").sign("walk")
    stage.graph.send(signed.replace("walk", "wave"))
    yield SPIN_TIMEOUT
    stage.graph.send(signed)
    stage.graph.wait_for(lambda: stage.graph.mode == "walk", WATCH, "walking as a signed command says")
    stage.ask("mode/stand")
    stage.graph.wait_for(lambda: stage.graph.mode == "stand", WATCH, "standing again")
    stage.graph.send(signed)
    yield WATCH


def stand_while_walking(stage: GraphStage) -> Iterator[float]:
    """Mode stand, while the user goes on commanding a velocity."""
    stage.ask("mode/stand")
    yield from ()


FREEZE_TIME = 0.2  # shorter than the timeouts [s]
LONG_FREEZE_TIME = 1.0  # longer than the timeouts [s]
MISMATCH_TIME = 3.0  # after which the checks before arming have seen it [s]
SPOILT_TIME, MOMENT = 1.0, 0.005  # for which messages are spoilt [s]


def _second_publisher(stage: GraphStage) -> Iterator[float]:
    publisher = stage.graph.node.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
    try:
        yield 1.0
    finally:
        stage.graph.node.destroy_publisher(publisher)


def _second_clock(stage: GraphStage) -> Iterator[float]:
    """A second clock, one hour ahead, at half the rate of the plant's."""
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
    """While the robot is damped, a second publisher of a latched topic is volatile."""
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
    """Two busy processes for each core."""
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
