"""Does the steps of a session, each in a process group of its own as a terminal would, and keeps what failed."""

import html
import os
import re
import shlex
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.ros_shell.steps import Step

STEP_TIME, END_TIME = 40.0, 20.0
"""Longest time of a step, and of its end after Ctrl-C [s]."""

LINES, LINE = 6, 160
"""Lines of an output that are printed, and characters of each [-]."""


class Shell:
    """Where commands are typed.

    Args:
        ros2: The words that stand for ``ros2``.
        environment: Variables.
        folder: Where the commands run, and their outputs are.

    Attributes:
        failed: Commands that did not show what they have to.
    """

    def __init__(self, ros2: Sequence[str], environment: Mapping[str, str], folder: Path) -> None:
        self.failed: list[str] = []
        self._ros2, self._environment, self._folder = list(ros2), dict(environment), folder
        self._outputs: dict[int, Path] = {}
        self._rows: list[tuple[str, str, str]] = []

    def do(self, step: Step, timeout: float = STEP_TIME) -> bool:
        """Do a step, again and again where it only looks.

        Returns:
            Whether it showed all that it has to.
        """
        end = time.monotonic() + timeout
        while True:
            process = self.start(step.command)
            missing = self._watch(process, step, timeout)
            if not missing or not step.again or time.monotonic() > end:
                break
        failure = f"not shown: {missing}" if missing else ""
        self.say(step.command, (*step.shows, *step.then), failure, self.output(process))
        return not missing

    def start(self, command: str) -> subprocess.Popen[bytes]:
        """Start a command."""
        with tempfile.NamedTemporaryFile(dir=self._folder, delete=False) as output:
            process = subprocess.Popen(
                [*self._ros2, *shlex.split(command)], stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                cwd=self._folder, env=self._environment, start_new_session=True, preexec_fn=_accept_ctrl_c,
            )  # fmt: skip
        self._outputs[process.pid] = Path(output.name)
        return process

    def end(self, process: subprocess.Popen[bytes]) -> int | None:
        """Ctrl-C, which a terminal sends to the whole group; what stays is killed.

        Returns:
            Exit status; None when it had to be killed.
        """
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)
        try:
            return process.wait(END_TIME)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return None

    def wait(self, process: subprocess.Popen[bytes], patterns: Sequence[str], timeout: float) -> bool:
        """Wait until all patterns are shown.

        Returns:
            False when the time is over, or the process has ended without.
        """
        end = time.monotonic() + timeout
        while self._missing(process, patterns):
            if process.poll() is not None or time.monotonic() > end:
                return not self._missing(process, patterns)
            time.sleep(0.1)
        return True

    def output(self, process: subprocess.Popen[bytes]) -> str:
        """What a process has written."""
        return self._outputs[process.pid].read_text(encoding="utf-8", errors="replace")

    def say(self, command: str, expected: Sequence[str], failure: str, output: str = "") -> None:
        """Print a command and the beginning of its output, or all of it with the failure, and keep its row."""
        lines = [f"    {line[:LINE]}" for line in output.strip().splitlines()]
        if failure:
            self.failed.append(command)
        elif len(lines) > LINES:
            lines[LINES:] = [f"    ... {len(lines) - LINES} more lines"]
        print(f"$ ros2 {command}", *lines, f"  {f'FAILED: {failure}' if failure else 'ok'}", sep="\n", flush=True)
        found = [match.group() for pattern in expected if (match := re.search(pattern, output))]
        self._rows.append((f"ros2 {command}", ", ".join(expected) or "it ends", failure or ", ".join(found) or "ok"))

    def table(self) -> str:
        """Table of command, expectation and what was seen, in Markdown."""
        head = ("command", "expected (regular expressions)", "seen")
        rows = [[_cell(text) for text in row] for row in self._rows]
        return "".join(f"| {' | '.join(row)} |\n" for row in [head, ("---",) * 3, *rows])

    def _watch(self, process: subprocess.Popen[bytes], step: Step, timeout: float) -> str:
        """First thing that a step did not show; empty when it showed all of them."""
        try:
            if not self.wait(process, step.shows, timeout):
                return self._missing(process, step.shows)
            if step.meanwhile is not None and not self.do(step.meanwhile):
                return step.meanwhile.command
            if not self.wait(process, step.then, timeout):
                return self._missing(process, step.then)
            if not step.stop:
                process.wait(timeout)
        except subprocess.TimeoutExpired:
            return "its end"
        finally:
            killed = self.end(process) is None
        return "its end after Ctrl-C" if killed else ""

    def _missing(self, process: subprocess.Popen[bytes], patterns: Sequence[str]) -> str:
        output = self.output(process)
        return next((pattern for pattern in patterns if not re.search(pattern, output)), "")


def _accept_ctrl_c() -> None:
    """A shell has what it runs in the background ignore Ctrl-C, and their children with it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _cell(text: str) -> str:
    """Text of one cell, as code, its beginning where it is long."""
    line = " ".join(text.split())
    line = line if len(line) <= LINE else f"{line[:LINE]}..."
    return f"<code>{html.escape(line).replace('|', '&#124;')}</code>"
