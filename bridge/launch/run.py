"""Runs one or several graphs until a signal, and reports events on the terminal."""

import os
import signal
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from typing import Any, Protocol

from rich.console import Console

from bridge.ros.processes import CLEAN_EXITS
from models.errors import PoiseError
from models.nodes.realtime import end_within
from models.nodes.spin import END_TIME

LOOK = 0.02  #: Polling period of a condition [s]


class Running(AbstractContextManager["Running"], Protocol):
    """One running graph, or several."""

    exit_codes: dict[str, int | None]

    def spin(self, duration: float) -> None:
        """Serve callbacks and supervise the processes for a time [s]."""

    def stop(self) -> None:
        """End the processes."""


class _Interrupted(Exception):
    """SIGINT or SIGTERM arrived."""


@contextmanager
def without_flow_control() -> Iterator[None]:
    """Disable Ctrl-S in the terminal of this process: it would block the output of a process and thus the process.

    Only a foreground job changes and restores the terminal; the kernel suspends a background job that does so.
    """
    before: list[Any] | None = None
    with suppress(OSError, termios.error):  # no terminal
        if os.tcgetpgrp(2) == os.getpgrp():
            before = termios.tcgetattr(2)
            termios.tcsetattr(2, termios.TCSANOW, [before[0] & ~termios.IXON, *before[1:]])
    try:
        yield
    finally:
        with suppress(OSError, termios.error):
            if before is not None and os.tcgetpgrp(2) == os.getpgrp():
                termios.tcsetattr(2, termios.TCSANOW, before)


def wait_for(
    spin: Callable[[float], object],
    condition: Callable[[], bool],
    timeout: float,
    what: str,
    state: Callable[[], str],
) -> None:
    """Serve callbacks by ``spin`` until a condition is met; it is polled every ``LOOK`` seconds.

    Raises ``PoiseError`` after ``timeout`` [s], with ``what`` (as in "not standing") and the present ``state``.
    """
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            raise PoiseError(f"not {what} within {timeout:.0f} s: {state()}")
        spin(LOOK)


def run_until_signal(
    make: Callable[[Callable[[str], object]], Running],
    name: str,
    *,
    duration: float | None,
    end: Callable[[Any], None] | None = None,
) -> int:
    """Run a graph until SIGINT or SIGTERM, or for a ``duration`` [s].

    ``make`` creates the graph; it receives a function that prints one line about an event. ``name`` is printed.
    ``end`` is called before the processes end, except after SIGTERM; a second SIGINT interrupts it. SIGTSTP is ignored,
    because the robot would go on without a launcher. Returns the exit code: 0 after a signal or the end of
    ``duration``, 1 when the graph cannot be kept running.
    """
    console = Console(stderr=True)
    begin = time.monotonic()

    def say(text: str) -> None:
        console.print(f"[dim]{time.monotonic() - begin:8.2f} s[/dim]  {text}", highlight=False, soft_wrap=True)

    interrupts_left = 0 if end is None else 1  # number of SIGINTs that do not end it at once

    def ignore_signals() -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)  # the shutdown must not be interrupted

    def on_signal(number: int, frame: Any) -> None:
        nonlocal interrupts_left
        interrupts_left = interrupts_left - 1 if number == signal.SIGINT else -1
        if interrupts_left < 0:
            ignore_signals()
        raise _Interrupted

    def on_suspend(number: int, frame: Any) -> None:
        # say() may be interrupted itself
        os.write(2, b"not suspended, because the robot would continue to move; Ctrl-C ends this\n")

    previous = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    previous[signal.SIGTSTP] = signal.signal(signal.SIGTSTP, on_suspend)
    code = 0

    @contextmanager
    def reported() -> Iterator[None]:
        nonlocal code
        try:
            yield
        except _Interrupted:
            say("ending")
        except PoiseError as error:
            console.print(f"[red]{error}[/red]", highlight=False)
            code = 1

    ending = ExitStack()
    ending.enter_context(without_flow_control())
    try:
        with reported(), make(say) as graph:
            with reported():
                say(f"{name} is up; Ctrl-C ends it")
                while duration is None or time.monotonic() - begin < duration:
                    graph.spin(0.2)
            if end is not None and interrupts_left >= 0:
                with reported():
                    say("lowering the robot; Ctrl-C damps it immediately")
                    end(graph)
            ignore_signals()
            graph.stop()
            for module, exit_code in graph.exit_codes.items():
                if exit_code not in CLEAN_EXITS:
                    say(f"{module} ended with code {exit_code}")
                    code = 1
            ending.callback(end_within(END_TIME, code))
    finally:
        ending.close()
        for number, handler in previous.items():
            signal.signal(number, handler)
    return code
