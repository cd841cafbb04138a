"""Processes that run beside a graph while it is measured: busy ones, listeners, a recording, the view."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.latency_config import Scenario
from bridge.ros.environment import graph_environment
from models.errors import PoiseError
from models.nodes.realtime import die_with_parent

STOP_LIMIT = 15.0
"""Longest wait for one of them to end; a recording completes its file [s]."""

_POISE = "from bridge.cli import app; app()"


@contextmanager
def companions(scenario: Scenario, domain_id: int, folder: Path) -> Iterator[dict[str, int]]:
    """Start what a scenario asks for, and end it afterwards.

    Args:
        scenario: What is asked for.
        domain_id: ROS domain of the graph.
        folder: For their files.

    Yields:
        Process id by name.

    Raises:
        PoiseError: One of them has ended before it was told to.
    """
    commands = {
        **{f"stress_{k}": ["-c", "while True: pass"] for k in range(scenario.stress)},
        **{f"subscriber_{k}": ["-m", "benchmarks.nodes.listener"] for k in range(scenario.subscribers)},
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
                    preexec_fn=die_with_parent,  # a command that is killed leaves none of them behind
                )
                if name.startswith("stress"):
                    os.sched_setaffinity(started[name].pid, {max(os.sched_getaffinity(0))})
        yield {name: process.pid for name, process in started.items()}
        ended = [name for name, process in started.items() if process.poll() is not None]
        if ended:
            said = (folder / "companions.log").read_text(encoding="utf-8", errors="replace")[-500:]
            raise PoiseError(f"{', '.join(ended)} ended while the graph was measured: {said}")
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
    """A TCP port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
