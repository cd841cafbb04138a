"""Processes of the graph: layout, parameters, start, end, and lifecycle transitions of their nodes."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from bridge.ros.heartbeat import VARIABLE, Heartbeat
from models.errors import ConfigError, PoiseError

if TYPE_CHECKING:
    from bridge.plants.config import DriverConfig

Parameters = Mapping[str, Mapping[str, object]]  #: Parameter values by node name, then by parameter name
_VALUES = "ros__parameters"  #: Key of the parameters of a node in a ROS 2 parameter file
_LAUNCHED = ("robot", "autostart", "lockstep")  #: Parameters that the launcher sets
#: Absolute topics that are remapped into the namespace, as in Nav2
GLOBAL_TOPICS = ("/clock", "/diagnostics", "/tf", "/tf_static")
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


def absolute_namespace(namespace: str) -> str:
    """Namespace with a leading slash, empty for none; ``PoiseError`` for an invalid name."""
    given = namespace.strip("/")
    if not given:
        return ""
    try:
        validate_namespace(f"/{given}")
    except InvalidNamespaceException as error:
        raise PoiseError(f"namespace '{namespace}': {str(error).splitlines()[0]}") from error
    return f"/{given}"


def namespace_rules() -> list[str]:
    """Arguments after ``--ros-args`` that remap ``GLOBAL_TOPICS`` into the namespace of the node."""
    return [word for topic in GLOBAL_TOPICS for word in ("-r", f"{topic}:={topic.removeprefix('/')}")]


def in_namespace(namespace: str) -> dict[str, Any]:
    """Keyword arguments of an rclpy node in a namespace in the form of ``absolute_namespace``."""
    if not namespace:
        return {}
    return {"namespace": namespace, "cli_args": ["--ros-args", *namespace_rules()]}


def ros_arguments(nodes: Sequence[str], parameters: Parameters, namespace: str, file: Path) -> list[str]:
    """Arguments of nodes in a namespace such as ``/robot_1`` or none; writes their parameters to ``file``."""
    write_parameters(file, {f"{namespace}/{node}": parameters.get(node, {}) for node in nodes})
    rules = ["-r", f"__ns:={namespace}", *namespace_rules()] if namespace else []
    return ["--ros-args", "--params-file", str(file), *rules]


def with_file(parameters: Parameters, file: Path) -> dict[str, dict[str, object]]:
    """Add the parameters of a ROS 2 file, ``NODE: {ros__parameters: {NAME: VALUE}}``; returns parameters by node.

    Nested names are joined by dots. Raises ``ConfigError`` when the file cannot be read or has another form, and for a
    parameter that is already set or that the launcher sets; options exist for these.
    """
    from models.config import read_yaml  # imported here: commands of one word must not wait for it

    result = {node: dict(values) for node, values in parameters.items()}
    for key, section in read_yaml(file).items():
        node = str(key).removeprefix("/")
        if not isinstance(section, dict) or list(section) != [_VALUES] or not isinstance(section[_VALUES], dict):
            raise ConfigError(f"{file}: {key}: expected one mapping, '{_VALUES}', of parameters to values")
        given = result.setdefault(node, {})
        for name, value in _dotted(section[_VALUES]):
            if name in given or name in _LAUNCHED:
                raise ConfigError(f"{file}: {node}: '{name}' is set by the command line or its options")
            if not isinstance(value, bool | int | float | str | list):
                raise ConfigError(f"{file}: {node}: '{name}' has no value that a parameter can have")
            given[name] = value
    return result


def _dotted(values: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Names and values of nested mappings, the names joined by dots."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _dotted(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def write_parameters(file: Path, parameters: Parameters) -> None:
    """Write a ROS 2 parameter file with values by full node name; ROS expects YAML, and JSON is valid YAML."""
    values = {node: {_VALUES: dict(given)} for node, given in parameters.items()}
    file.write_text(json.dumps(values), encoding="utf-8")


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


CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE
_LABELS = {CONFIGURE: "configure", ACTIVATE: "activate", DEACTIVATE: "deactivate"}
_UNCONFIGURED, _INACTIVE = State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE
_GOALS = {CONFIGURE: _INACTIVE, ACTIVATE: State.PRIMARY_STATE_ACTIVE, DEACTIVATE: _INACTIVE}
_STARTS = {CONFIGURE: _UNCONFIGURED, ACTIVATE: _INACTIVE, DEACTIVATE: State.PRIMARY_STATE_ACTIVE}

REPORT_PERIOD = 10.0  #: Time between two reports of the nodes that are awaited [s]
ASK_AGAIN = 1.0  #: Time without an answer after which a node's state is requested [s]


class _Change:
    """One transition of one node.

    A reply is lost when the node has not yet discovered the reader, and DDS does not report that. The state of a node
    that does not answer is therefore requested: the goal state means a lost reply, the start state twice a lost
    request. Once, a busy node may have answered before it begins. The state is also requested after a refusal, as an
    earlier request may have reached the goal.
    """

    def __init__(self, node: Any, name: str, transition: int) -> None:
        self.name, self.done, self.refused = name, False, False
        self._transition = transition
        self._node = node
        self._change = node.create_client(ChangeState, f"{name}/change_state")
        self._get = node.create_client(GetState, f"{name}/get_state")
        self._reply: Any = None
        self._state: Any = None
        self._asked = 0.0
        self._unchanged = False  # whether an answer since the last request was that the transition had not begun

    def update(self) -> None:
        """Send what is due and process replies."""
        now = time.monotonic()
        if self._reply is None:
            if self._change.service_is_ready() and self._get.service_is_ready():
                self._send(now)
        elif self._reply.done() and self._reply.result().success:
            self.done = True
        elif self._state is not None and self._state.done():
            state = self._state.result().current_state.id
            self._state = None
            if state == _GOALS[self._transition] or self._reply.done():
                self.done, self.refused = True, state != _GOALS[self._transition]
            elif state == _STARTS[self._transition]:
                if self._unchanged:
                    self._send(now)
                else:
                    self._unchanged = True
        elif now - self._asked > ASK_AGAIN or (self._reply.done() and self._state is None):
            self._asked = now
            self._state = self._get.call_async(GetState.Request())

    def _send(self, now: float) -> None:
        request = ChangeState.Request()
        request.transition.id = self._transition
        self._reply = self._change.call_async(request)
        self._asked, self._unchanged = now, False

    def close(self) -> None:
        """Destroy the clients."""
        self._node.destroy_client(self._change)
        self._node.destroy_client(self._get)


def change_state(
    node: Any,
    spin: Callable[[], None],
    names: Sequence[str],
    transition: int,
    timeout: float,
    say: Callable[[str], object] = lambda text: None,
) -> None:
    """Request a transition (``CONFIGURE``, ``ACTIVATE`` or ``DEACTIVATE``) of several nodes at once and wait for all.

    ``spin`` serves callbacks for a short time; it raises to abort. Raises ``PoiseError`` with the name of a node that
    refuses or does not answer within ``timeout`` [s]. ``say`` receives the nodes that are awaited, every
    ``REPORT_PERIOD`` seconds.
    """
    begin = time.monotonic()
    end, report = begin + timeout, begin + REPORT_PERIOD
    changes = [_Change(node, name, transition) for name in names]
    try:
        while left := [change for change in changes if not change.done]:
            for change in left:
                change.update()
            spin()
            if (now := time.monotonic()) > report:
                report = now + REPORT_PERIOD
                awaited = ", ".join(change.name for change in left)
                say(
                    f"waiting for '{_LABELS[transition]}' of {awaited} for {now - begin:.0f} s, at most {timeout:.0f} s"
                )
            if now > end:
                late = ", ".join(change.name for change in left)
                kept = "compiled code is kept: try again"
                raise PoiseError(f"{late}: no answer to '{_LABELS[transition]}' in {timeout:.0f} s; {kept}")
    finally:
        for change in changes:
            change.close()
    refused = [change.name for change in changes if change.refused]
    if refused:
        raise PoiseError(f"{', '.join(refused)}: refused to {_LABELS[transition]}; the log has the reason")


Processes = Literal["shared", "separate"]  #: Whether gait planner, controller and estimator share one
BRIDGE = ProcessSpec("bridge.nodes.robot_driver", ("robot_driver",))
CONTROL = ProcessSpec("bridge.nodes.control", ("gait_planner", "balance_controller", "state_estimator"))
GAIT = ProcessSpec("planners.nodes.gait_planner", ("gait_planner",))
ESTIMATOR = ProcessSpec("controllers.nodes.state_estimator", ("state_estimator",))
CONTROLLER = ProcessSpec("controllers.nodes.balance_controller", ("balance_controller",))
PLANNER = ProcessSpec("planners.nodes.motion_planner", ("motion_planner",))
SUPERVISOR = ProcessSpec("controllers.nodes.supervisor", ("supervisor",))

ACTIONS = ProcessSpec("bridge.nodes.action_server", ("action_server",), optional=True)
CAMERA = ProcessSpec("bridge.nodes.camera_node", ("camera_node",), optional=True)
RANGES = ProcessSpec("bridge.nodes.range_sensor_node", ("range_sensor_node",), optional=True)
TERRAIN = ProcessSpec("planners.nodes.terrain_mapper", ("terrain_mapper",), optional=True)
GROUND = ProcessSpec("planners.nodes.ground_planner", ("ground_planner",), optional=True)

REALTIME_NODES = ("robot_driver", "state_estimator", "balance_controller")
#: If permitted, the processes of the tick run with real-time priority and locked memory
REALTIME: Mapping[str, object] = {"realtime.priority": 40, "realtime.lock_memory": True}
#: Below the ticks; on two busy cores they would delay a supervisor without priority by half a second
SUPERVISOR_REALTIME: Mapping[str, object] = {"realtime.priority": 30}
#: Parameters when simulated time waits for late commands; a silent clock is then only slow
YIELDING: Parameters = {
    "state_estimator": {"waits": True},
    "balance_controller": {"waits": True},
    "supervisor": {"clock_timeout": 10.0},
}
CALIBRATED_NODES = ("robot_driver", "state_estimator")  #: Nodes with the parameter ``calibration_dir``
RATED_NODES = frozenset({"balance_controller", "supervisor"})  #: Nodes with the parameter ``sensor_rate``
LOCKSTEP_NODES = frozenset({"robot_driver", "state_estimator", "balance_controller", "supervisor"})


def process_specs(
    processes: Processes = "shared",
    *,
    actions: bool = False,
    camera: bool = False,
    terrain_map: bool = False,
    given_map: bool = False,
) -> list[ProcessSpec]:
    """Processes of the graph, the plant first; gait planner, controller and estimator share a process or are separate.

    Both ``terrain_map`` and ``given_map`` add the mapping of the ground: from range sensors, or from a given map.
    """
    control = [CONTROL] if processes == "shared" else [GAIT, CONTROLLER, ESTIMATOR]
    mapping = [TERRAIN, GROUND] if terrain_map or given_map else []
    seeing = [*([CAMERA] if camera else []), *([RANGES] if terrain_map else []), *mapping]
    return [BRIDGE, *control, PLANNER, SUPERVISOR, *([ACTIONS] if actions else []), *seeing]


def activation_order(specs: Sequence[ProcessSpec]) -> list[str]:
    """Nodes in activation order: the order of the processes, with the plant last."""
    return [*(name for spec in specs for name in spec.nodes if name not in BRIDGE.nodes), *BRIDGE.nodes]


def sensor_rate(extra: Parameters) -> float | None:
    """Rate of the sensor topics in the parameters of the driver [Hz]; None if not set."""
    driver = extra.get("robot_driver", {})
    rate = driver.get("sensor_rate") or driver.get("rate")
    return float(str(rate)) if rate else None


def time_budget(rate: float, speed: float) -> dict[str, float]:
    """Parameter ``time_budget`` of the controller: real time between states at a rate [Hz], if time is slowed down."""
    return {"time_budget": 1.0 / (rate * speed)} if speed < 1.0 else {}


def follows_clock(driver: Mapping[str, object]) -> bool:
    """Whether time follows the clock, from the driver's parameters: for a real plant, or a strict simulation."""
    default = _driver_default()
    return driver.get("plant", default.plant) != default.plant or driver.get("real_time", default.real_time) == "strict"


def _driver_default() -> "DriverConfig":
    from bridge.plants.config import DriverConfig  # imported here: commands of one word must not wait for it
    from models.config import default_config

    return default_config(DriverConfig, "bridge", "robot_driver")


def _of_gait(planner: Mapping[str, object]) -> dict[str, object]:
    """Gait parameters of the gait planner, renamed for the controller."""
    from planners.gait.config import GaitConfig  # imported here: commands of one word must not wait for it

    names = {each.name for each in fields(GaitConfig)}
    return {f"gait.{name}": value for name, value in planner.items() if name.partition(".")[0] in names}


def node_parameters(
    specs: list[ProcessSpec], robot: str, lockstep: bool, calibrations: Path, extra: Parameters
) -> dict[str, dict[str, object]]:
    """Parameters of every node: the robot, lockstep if needed, and ``extra`` by node, which override the others.

    ``calibrations`` is the folder of the calibration files. Parameters of the driver are accepted even if another
    launcher runs it. Raises ``PoiseError`` for an unknown node and lists the valid names.
    """
    names = [name for spec in specs for name in spec.nodes]
    unknown = [name for name in extra if name not in (*names, *BRIDGE.nodes)]
    if unknown:
        raise PoiseError(f"parameters for unknown nodes: {', '.join(unknown)}; known: {', '.join(names)}")
    timing = YIELDING
    if not lockstep and follows_clock(extra.get("robot_driver", {})):
        timing = {**dict.fromkeys(REALTIME_NODES, REALTIME), "supervisor": SUPERVISOR_REALTIME}
    result: dict[str, dict[str, object]] = {}
    # A controller that is not in the process of the gait planner executes the gait with the same parameters
    apart = any("balance_controller" in spec.nodes and "gait_planner" not in spec.nodes for spec in specs)
    gait = _of_gait(extra.get("gait_planner", {})) if apart else {}
    extra = {**extra, "balance_controller": {**gait, **extra.get("balance_controller", {})}}
    for name in names:
        calibrated = {"calibration_dir": str(calibrations)} if name in CALIBRATED_NODES else {}
        # the launcher activates all nodes, including those that support autostart
        result[name] = {"robot": robot, "autostart": False, **timing.get(name, {}), **calibrated, **extra.get(name, {})}
    rate, speed = sensor_rate(extra), float(str(extra.get("robot_driver", {}).get("speed", 1.0)))
    if rate is not None:
        for name in result.keys() & RATED_NODES:
            result[name].setdefault("sensor_rate", rate)
    if "balance_controller" in result:
        result["balance_controller"] = {
            **time_budget(rate or _driver_default().rate, speed),
            **result["balance_controller"],
        }
    if lockstep:
        for name in result.keys() & LOCKSTEP_NODES:
            result[name]["lockstep"] = True
    return result
