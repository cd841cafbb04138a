"""Start, supervision by heartbeat, and end of the processes of the graph."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import IO

from bridge.ros.heartbeat import VARIABLE, Heartbeat

#: Signals that end a process, and the wait after each [s]
STOP_SIGNALS = ((signal.SIGTERM, 7.0), (signal.SIGKILL, 2.0))
#: Exit codes of a process that ended on request: 0 once its nodes are up, the signal's during imports
CLEAN_EXITS = (0, -signal.SIGTERM)


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """A Python module with a ``main``, and its nodes in activation order; the graph goes on without an optional one.

    ``arguments`` precede the ROS arguments; ``environment`` extends the environment of the graph. ``silence_max`` is
    the longest accepted time between heartbeats [s]; None for a process without heartbeat.
    """

    module: str
    nodes: tuple[str, ...]
    optional: bool = False
    arguments: tuple[str, ...] = ()
    environment: Mapping[str, str] = field(default_factory=dict)
    silence_max: float | None = None


class GraphProcess:
    """Starts and ends one process.

    ``environment`` extends the environment of this process. ``output`` is a file, or the output of this process when
    None; a change applies from the next start.
    """

    def __init__(
        self,
        spec: ProcessSpec,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        output: IO[bytes] | None = None,
    ) -> None:
        self.spec = spec
        self.restarts = 0
        self._command = [sys.executable, "-m", spec.module, *arguments]
        self._environment = {**os.environ, **environment}
        self.output = output
        self._process: subprocess.Popen[bytes] | None = None
        self._heartbeat: Heartbeat | None = None

    @property
    def pid(self) -> int:
        """Process id; 0 before the start."""
        return self._process.pid if self._process is not None else 0

    @property
    def exit_code(self) -> int | None:
        """Exit code; None while it runs or before the start."""
        return self._process.poll() if self._process is not None else None

    def start(self) -> None:
        """Start in a new session, so that Ctrl-C reaches only the launcher."""
        environment, inherited = self._environment, tuple[int, ...]()
        if self.spec.silence_max is not None:
            if self._heartbeat is not None:
                self._heartbeat.close()
            self._heartbeat = Heartbeat()
            inherited = (self._heartbeat.writer,)
            environment = {**environment, VARIABLE: str(self._heartbeat.writer)}
        self._process = subprocess.Popen(
            self._command,
            env=environment,
            pass_fds=inherited,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=self.output,
            stderr=self.output,
        )
        for end in inherited:
            os.close(end)

    def kill_silent(self) -> bool:
        """Kill the process if it runs without a heartbeat for ``silence_max``; returns whether it was killed."""
        limit = self.spec.silence_max
        if limit is None or self._heartbeat is None or self.exit_code is not None:
            return False
        if silent := self._heartbeat.silent(limit):
            self.signal(signal.SIGKILL)
        return silent

    def signal(self, number: int) -> None:
        """Send a signal if the process still runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(number)


def stop_all(processes: Sequence[GraphProcess]) -> dict[str, int | None]:
    """End processes by ``STOP_SIGNALS``, gracefully first; returns the exit codes by module."""
    for number, timeout in STOP_SIGNALS:
        left = [process for process in processes if process.pid and process.exit_code is None]
        for process in left:
            process.signal(number)
        end = time.monotonic() + timeout
        while any(process.exit_code is None for process in left) and time.monotonic() < end:
            time.sleep(0.01)
    return {process.spec.module: process.exit_code for process in processes}
