"""Run nodes in one process until a signal; the exit code reports failures."""

import os
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import ok, try_shutdown

from models.errors import ConfigError, PoiseError, did_you_mean
from models.nodes import realtime

SUPERVISED = "POISE_SUPERVISED"  #: Set by the launcher for processes that must end with it
END_TIME = 3  #: Maximum delay of the end of a process by the middleware [s]
SPIN_TIMEOUT = 0.1  #: Maximum time between two checks of the stop flag [s]


def log_variables() -> dict[str, str]:
    """Environment variables for rclpy's log folder if neither it nor HOME is set; rclpy would fail without."""
    if "HOME" in os.environ or "ROS_LOG_DIR" in os.environ:
        return {}
    return {"ROS_LOG_DIR": str(Path(tempfile.gettempdir()) / f"ros_log_{os.getuid()}")}


def log_arguments() -> list[str]:
    """Arguments for ``rclpy.init`` that disable log files if none can be written."""
    home = Path(os.environ.get("ROS_HOME") or Path(os.environ.get("HOME", "/")) / ".ros")
    folder = Path(os.environ.get("ROS_LOG_DIR") or home / "log")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        reason = "" if os.access(folder, os.W_OK | os.X_OK) else "not writable"
    except OSError as error:
        reason = str(error.strerror)
    if not reason:
        return []
    with suppress(OSError):  # the terminal may be a file on the same disk
        print(f"no log files in {folder}: {reason}; logs are printed only", file=sys.stderr, flush=True)
    return ["--ros-args", "--disable-external-lib-logs"]


class Stop:
    """Flag set by SIGINT and SIGTERM."""

    def __init__(self) -> None:
        self.requested = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: object) -> None:
        self.requested = True


def make_executor(context: Any = None) -> Any:
    """Events executor if rclpy has it (a quarter of the processor time), else the single-threaded executor."""
    try:
        from rclpy.experimental.events_executor import EventsExecutor
    except ImportError:
        from rclpy.executors import SingleThreadedExecutor

        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def spin(executor: Any, nodes: Sequence[Any], stop: Stop) -> None:
    """Execute callbacks until a signal; uses ``spin_once``, because ``EventsExecutor.spin`` executes no callbacks."""
    while ok() and not stop.requested:
        executor.spin_once(timeout_sec=SPIN_TIMEOUT)


def run(
    factories: list[Callable[[], Any]],
    args: Sequence[str] | None = None,
    loop: Callable[[Any, Sequence[Any], Stop], None] = spin,
    make: Callable[[], Any] = make_executor,
) -> int:
    """Create nodes, bring up those with autostart, and run them until SIGINT or SIGTERM.

    Each of ``factories`` creates one node; the list is emptied, because factories may hold references to nodes.
    ``args`` is the command line with ROS arguments, that of the process when None. ``loop`` spins the executor of
    ``make`` until the stop flag is set. Returns 0 after a signal, 1 if a callback raised, a node with autostart did not
    start, or a parameter is unknown, of a wrong type or out of range.
    """
    if os.environ.get(SUPERVISED):
        realtime.die_with_parent()
    os.environ.update(log_variables())
    given = [*(sys.argv if args is None else args), *log_arguments()]
    rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    stop = Stop()
    nodes: list[Any] = []
    executor = make()
    code = 0
    try:
        while factories:
            nodes.append(factories.pop(0)())
            executor.add_node(nodes[-1])
        refuse_undeclared(nodes)
        _bring_up(nodes)
        loop(executor, nodes, stop)
    except (PoiseError, ParameterException) as error:
        print(error, file=sys.stderr, flush=True)
        code = 1
    except Exception:  # a partly failed node must not continue: log it and end the process
        traceback.print_exc()
        code = 1
    finally:
        _shut_down(nodes)
        sys.stdout.flush()
        cancel = realtime.end_within(END_TIME, code)
        while nodes:
            _end(executor, nodes.pop(0))
        try_shutdown()
    del executor
    realtime.release()
    cancel()
    return code


def program(*nodes: Callable[[], Any], **options: Any) -> Callable[..., None]:
    """Entry point of a process that calls ``run`` with nodes and ``options`` and exits with its code."""

    def main(args: list[str] | None = None) -> None:
        sys.exit(run(list(nodes), args, **options))

    return main


def refuse_undeclared(nodes: Sequence[Any]) -> None:
    """Refuse a parameter of the command line or a file that no node of this process declares; rclpy would ignore it.

    Raises ``ConfigError`` with its name and the nearest known name.
    """
    declared = tuple(name for node in nodes for name in node.get_parameters_by_prefix(""))
    for node in nodes:
        for name in node._parameter_overrides:  # rclpy has no public way to read them
            if name not in declared:
                raise ConfigError(f"{node.get_name()}: unknown parameter '{name}'{did_you_mean(name, declared)}")


# Separate functions, so that no local variable of ``run`` keeps a node alive


def _bring_up(nodes: Sequence[Any]) -> None:
    for node in nodes:
        if getattr(node, "autostart", False):
            node.bring_up()


def _shut_down(nodes: Sequence[Any]) -> None:
    for node in nodes:
        node.trigger_shutdown()


def _end(executor: Any, node: Any) -> None:
    executor.remove_node(node)
    node.destroy_node()
