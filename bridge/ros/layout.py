"""Processes of the graph, their nodes, and the nodes' start parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bridge.ros.processes import Parameters, ProcessSpec
from models.errors import PoiseError

BRIDGE = ProcessSpec("bridge.nodes.robot_driver", ("robot_driver",))
CONTROL = ProcessSpec("bridge.nodes.control", ("gait_planner", "balance_controller", "state_estimator"))
ESTIMATOR = ProcessSpec("controllers.nodes.state_estimator", ("state_estimator",))
CONTROLLER = ProcessSpec("controllers.nodes.balance_controller", ("balance_controller",))
PLANNER = ProcessSpec("planners.nodes.motion_planner", ("motion_planner",))
SUPERVISOR = ProcessSpec("controllers.nodes.supervisor", ("supervisor",))

ACTIONS = ProcessSpec("bridge.nodes.action_server", ("action_server",), optional=True)
CAMERA = ProcessSpec("bridge.nodes.camera_node", ("camera_node",), optional=True)

REALTIME_NODES = ("robot_driver", "state_estimator", "balance_controller")
#: Where permitted, the processes of the tick run before everything else and keep their memory
REALTIME: Mapping[str, object] = {"realtime.priority": 40, "realtime.lock_memory": True}
CALIBRATED_NODES = ("robot_driver", "state_estimator")  #: Nodes with the parameter ``calibration_dir``
LOCKSTEP_NODES = frozenset({"robot_driver", "state_estimator", "balance_controller", "supervisor"})


def process_specs(*, merged: bool, actions: bool = False, camera: bool = False) -> list[ProcessSpec]:
    """Processes of the graph, the plant's first; actions and camera run in separate ones.

    Unless ``merged``, estimator and controller are apart and there is no gait planner, because its reference would have
    to be transferred at 1 kHz.
    """
    control = [CONTROL] if merged else [ESTIMATOR, CONTROLLER]
    return [BRIDGE, *control, PLANNER, SUPERVISOR, *([ACTIONS] if actions else []), *([CAMERA] if camera else [])]


def activation_order(specs: Sequence[ProcessSpec]) -> list[str]:
    """Nodes in the order of their activation: as the processes host them, the plant last."""
    return [*(name for spec in specs for name in spec.nodes if name not in BRIDGE.nodes), *BRIDGE.nodes]


def sensor_rate(extra: Parameters) -> float | None:
    """Rate of the sensor topics where the driver's parameters set one [Hz]."""
    driver = extra.get("robot_driver", {})
    rate = driver.get("sensor_rate") or driver.get("rate")
    return float(str(rate)) if rate else None


def node_parameters(
    specs: list[ProcessSpec], robot: str, lockstep: bool, calibrations: Path, extra: Parameters
) -> dict[str, dict[str, object]]:
    """Parameters of every node: the robot, lockstep where needed, and ``extra`` by node, which override all others.

    ``calibrations`` is the folder of the calibration files. Raises ``PoiseError`` for an unknown node and lists the
    valid ones.
    """
    names = [name for spec in specs for name in spec.nodes]
    unknown = [name for name in extra if name not in names]
    if unknown:
        raise PoiseError(f"parameters for unknown nodes: {', '.join(unknown)}; known: {', '.join(names)}")
    result: dict[str, dict[str, object]] = {}
    for name in names:
        realtime = REALTIME if name in REALTIME_NODES and not lockstep else {}
        calibrated = {"calibration_dir": str(calibrations)} if name in CALIBRATED_NODES else {}
        result[name] = {"robot": robot, **realtime, **calibrated, **extra.get(name, {})}
    rate = sensor_rate(extra)
    if rate is not None and "supervisor" in result:
        result["supervisor"].setdefault("sensor_rate", rate)
    if lockstep:
        for name in result.keys() & LOCKSTEP_NODES:
            result[name]["lockstep"] = True
    return result
