"""One operating-system process of the graph: what it hosts, how it starts and how it ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from models.errors import PoiseError

Parameters = Mapping[str, Mapping[str, object]]
"""Parameter values by node name, then by parameter name."""

GLOBAL_TOPICS = ("/clock", "/diagnostics", "/tf", "/tf_static")
"""Topics that a namespace does not move by itself: they are remapped into it, as Nav2 does."""

STOP_SIGNALS = ((signal.SIGTERM, 7.0), (signal.SIGKILL, 2.0))
"""What a process is sent to end it, and how long it is given each time [s]."""

CLEAN_EXITS = (0, -signal.SIGTERM)
"""Exit codes of a process that ended when told to: 0 once its nodes are up, the signal's while it still imports."""


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """What a process runs.

    Attributes:
        module: Python module with a ``main``.
        nodes: Names of the nodes it hosts, in the order of their activation.
        optional: Whether the graph goes on without it once it has crashed too often.
    """

    module: str
    nodes: tuple[str, ...]
    optional: bool = False


def ros_arguments(nodes: Sequence[str], parameters: Parameters) -> list[str]:
    """Command line that sets the parameters of the given nodes; JSON is valid YAML, which ROS expects."""
    arguments = ["--ros-args"]
    for node in nodes:
        for name, value in parameters.get(node, {}).items():
            arguments += ["-p", f"{node}:{name}:={json.dumps(value)}"]
    return arguments


def absolute_namespace(namespace: str) -> str:
    """A namespace with its leading slash; empty for none.

    Raises:
        PoiseError: It is no valid name.
    """
    given = namespace.strip("/")
    if not given:
        return ""
    try:
        validate_namespace(f"/{given}")
    except InvalidNamespaceException as error:
        raise PoiseError(f"namespace '{namespace}': {str(error).splitlines()[0]}") from error
    return f"/{given}"


def namespace_rules() -> list[str]:
    """Arguments after ``--ros-args`` that bring a node's ``GLOBAL_TOPICS`` into its namespace."""
    return [word for topic in GLOBAL_TOPICS for word in ("-r", f"{topic}:={topic.removeprefix('/')}")]


def in_namespace(namespace: str) -> dict[str, Any]:
    """Keyword arguments of a node of rclpy that lives in a robot's namespace, as ``absolute_namespace`` gives it."""
    if not namespace:
        return {}
    return {"namespace": namespace, "cli_args": ["--ros-args", *namespace_rules()]}


def namespaced_arguments(nodes: Sequence[str], parameters: Parameters, namespace: str, file: Path) -> list[str]:
    """Command line of nodes in a namespace, their parameters in a file: ``-p node:name:=value`` finds no node there.

    Args:
        nodes: Names of the nodes.
        parameters: Values by node.
        namespace: Such as ``/robot_1``.
        file: Is written.
    """
    write_parameters(file, {f"{namespace}/{node}": parameters.get(node, {}) for node in nodes})
    return ["--ros-args", "--params-file", str(file), "-r", f"__ns:={namespace}", *namespace_rules()]


def write_parameters(file: Path, parameters: Parameters) -> None:
    """Write a parameter file of ROS 2: values by full node name."""
    values = {node: {"ros__parameters": dict(given)} for node, given in parameters.items()}
    file.write_text(json.dumps(values), encoding="utf-8")


class GraphProcess:
    """Starts and ends one process.

    Args:
        spec: What it runs.
        parameters: Values by node.
        environment: Variables beside those of this process.
        output: Where its output goes; this process's when None.
        namespace: Of its nodes, as ``absolute_namespace`` gives it.
        folder: Where the parameters of nodes in a namespace are written.
        arguments: Command line instead of that which follows from parameters and namespace.

    Attributes:
        spec: What it runs.
        restarts: How often it was started again.
        output: Where its output goes from the next start on.
    """

    def __init__(
        self,
        spec: ProcessSpec,
        parameters: Parameters,
        environment: Mapping[str, str],
        output: IO[bytes] | None = None,
        namespace: str = "",
        folder: Path = Path(),
        arguments: Sequence[str] | None = None,
    ) -> None:
        self.spec = spec
        self.restarts = 0
        if arguments is not None:
            arguments = list(arguments)
        elif namespace:
            arguments = namespaced_arguments(spec.nodes, parameters, namespace, folder / f"{spec.module}.yaml")
        else:
            arguments = ros_arguments(spec.nodes, parameters)
        self._command = [sys.executable, "-m", spec.module, *arguments]
        self._environment = {**os.environ, **environment}
        self.output = output
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int:
        """Process id; 0 before the start."""
        return self._process.pid if self._process is not None else 0

    @property
    def exit_code(self) -> int | None:
        """How it ended; None while it runs or before the start."""
        return self._process.poll() if self._process is not None else None

    def start(self) -> None:
        """Start in a session of its own, so that Ctrl-C reaches the launcher alone."""
        self._process = subprocess.Popen(
            self._command,
            env=self._environment,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=self.output,
            stderr=self.output,
        )

    def signal(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(number)


def stop_all(processes: Sequence[GraphProcess]) -> dict[str, int | None]:
    """End processes, the gentle way first.

    Returns:
        Exit code by module.
    """
    for number, patience in STOP_SIGNALS:
        left = [process for process in processes if process.pid and process.exit_code is None]
        for process in left:
            process.signal(number)
        end = time.monotonic() + patience
        while any(process.exit_code is None for process in left) and time.monotonic() < end:
            time.sleep(0.01)
    return {process.spec.module: process.exit_code for process in processes}
