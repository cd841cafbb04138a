"""What rows of ``poise bench graph_faults`` do to processes: kill, freeze, prod, deactivate, shift their wall clock."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator

from benchmarks.nodes.graph_stage import GraphStage
from bridge.ros.lifecycle_client import ACTIVATE, DEACTIVATE, change_state
from models.errors import PoiseError

Act = Callable[[GraphStage], Iterator[float]]
"""Does something, then yields for how long the robot is to be watched before the next part [s]."""

TRANSITION_TIME = 20.0
"""Longest wait for a node to change its state [s]."""

COLLECTIONS, COLLECTION_PERIOD = 10, 0.2
"""How often garbage is collected, and how long after the last time [s]."""

HOUR = 3600.0
"""By which a wall clock jumps [s]."""


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
