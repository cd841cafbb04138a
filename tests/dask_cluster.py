"""A scheduler of dask and workers, each a process of its own as the documentation says, for tests of sweeps."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

TIMEOUT = 60.0
"""Longest wait for a process [s]."""


class Cluster:
    """Processes of dask, each started as the documentation says, that end with the test.

    Args:
        folder: For what they say.
        root: Of the checkout, from which they run.
        stack: Ends them.
    """

    def __init__(self, folder: Path, root: Path, stack: ExitStack) -> None:
        self._folder, self._root, self._stack, self._count = folder, root, stack, 0
        self.address = ""

    def start(
        self, *words: str, source: Path | None = None, machine: Sequence[str] = ()
    ) -> tuple[subprocess.Popen[bytes], Path]:
        """Start a program of dask.

        Args:
            words: Its command line.
            source: First on the path of Python; the checkout when None.
            machine: Command that runs it on another machine.

        Returns:
            Its process, and the file of what it says.
        """
        self._count += 1
        log = self._folder / f"dask-{self._count}.log"
        environment = dict(os.environ) | {"PYTHONPATH": str(source or self._root)}
        command = [*machine, sys.executable, "-m", "dask", *words, "--no-dashboard"]
        with log.open("wb") as file:
            process = subprocess.Popen(command, cwd=self._folder, env=environment, stdout=file, stderr=file)
        self._stack.callback(_end, process)
        return process, log

    def scheduler(self, source: Path | None = None, host: str = "127.0.0.1") -> subprocess.Popen[bytes]:
        """Start a scheduler on a free port and note its address."""
        process, log = self.start("scheduler", "--host", host, "--port", "0", source=source)
        found = _said(log, r"Scheduler at:\s+(tcp://\S+)")
        self.address = found.group(1)
        return process

    def worker(self, source: Path | None = None, machine: Sequence[str] = ()) -> tuple[subprocess.Popen[bytes], int]:
        """Start a nanny with one worker, and wait until it is known; the nanny, and the worker's process."""
        nanny, log = self.start(
            "worker", self.address, "--nworkers", "1", "--nthreads", "1", source=source, machine=machine
        )
        _said(log, r"Registered to:")
        return nanny, _children(nanny.pid)[-1]


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _said(file: Path, pattern: str) -> re.Match[str]:
    give_up = time.monotonic() + TIMEOUT
    while time.monotonic() < give_up:
        if found := re.search(pattern, file.read_text(errors="replace")):
            return found
        time.sleep(0.05)
    raise AssertionError(f"'{pattern}' was not said:\n{file.read_text(errors='replace')}")


def _children(pid: int) -> list[int]:
    """Workers of a nanny, the resource tracker of multiprocessing left out."""
    found = subprocess.run(["pgrep", "-P", str(pid), "-f", "spawn_main"], capture_output=True, text=True, check=True)
    return [int(word) for word in found.stdout.split()]
