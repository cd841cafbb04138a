"""Parameters of the nodes of the graph, and the arguments that pass them on."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bridge.launch.layout import BRIDGE
from bridge.ros.namespace import namespace_rules
from bridge.ros.processes import ProcessSpec
from models.errors import ConfigError, PoiseError

if TYPE_CHECKING:
    from bridge.plants.config import DriverConfig

Parameters = Mapping[str, Mapping[str, object]]  #: Parameter values by node name, then by parameter name
_VALUES = "ros__parameters"  #: Key of the parameters of a node in a ROS 2 parameter file
_LAUNCHED = ("robot", "autostart", "lockstep")  #: Parameters that the launcher sets

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


def sensor_rate(extra: Parameters) -> float | None:
    """Rate of the sensor topics in the parameters of the driver [Hz]; None if not set."""
    driver = extra.get("robot_driver", {})
    rate = driver.get("sensor_rate") or driver.get("rate")
    return float(str(rate)) if rate else None


def time_budget(rate: float, speed: float) -> dict[str, float]:
    """Parameter ``time_budget`` of the controller for states at a rate [Hz]; none unless time is slowed down.

    It is the real time between two states [s].
    """
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
