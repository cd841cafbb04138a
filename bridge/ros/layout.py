"""Which nodes share a process in the graph, and with what parameters each one starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from bridge.ros.processes import Parameters, ProcessSpec
from models.errors import PoiseError

BRIDGE = ProcessSpec("bridge.nodes.mujoco_bridge", ("mujoco_bridge",))
CONTROL = ProcessSpec("bridge.nodes.control", ("gait_planner", "balance_controller", "state_estimator"))
ESTIMATOR = ProcessSpec("controllers.nodes.state_estimator", ("state_estimator",))
CONTROLLER = ProcessSpec("controllers.nodes.balance_controller", ("balance_controller",))
PLANNER = ProcessSpec("planners.nodes.motion_planner", ("motion_planner",))
SUPERVISOR = ProcessSpec("controllers.nodes.supervisor", ("supervisor",))

ACTIONS = ProcessSpec("bridge.nodes.action_server", ("action_server",), optional=True)
CAMERA = ProcessSpec("bridge.nodes.camera_node", ("camera_node",), optional=True)

REALTIME_NODES = ("mujoco_bridge", "state_estimator", "balance_controller")
REALTIME: Mapping[str, object] = {"realtime.priority": 40, "realtime.lock_memory": True}
"""Where permitted, the processes of the tick run before everything else and keep their memory."""

CALIBRATED_NODES = ("mujoco_bridge", "state_estimator")
"""Nodes with the parameter ``calibration_dir``."""

LOCKSTEP_NODES = frozenset({"mujoco_bridge", "state_estimator", "balance_controller", "supervisor"})


def process_specs(*, merged: bool, actions: bool = False, camera: bool = False) -> list[ProcessSpec]:
    """Processes of the graph, the plant's first.

    Args:
        merged: Whether estimator, gait planner and controller share a process; apart, there is no gait planner, because
            its reference would have to travel at 1 kHz.
        actions: Whether to offer actions, in a process of their own.
        camera: Whether to draw the robot's camera, in a process of its own.
    """
    control = [CONTROL] if merged else [ESTIMATOR, CONTROLLER]
    return [BRIDGE, *control, PLANNER, SUPERVISOR, *([ACTIONS] if actions else []), *([CAMERA] if camera else [])]


def activation_order(specs: Sequence[ProcessSpec]) -> list[str]:
    """Nodes in the order of their activation: as the processes host them, the plant last."""
    return [*(name for spec in specs for name in spec.nodes if name not in BRIDGE.nodes), *BRIDGE.nodes]


def node_parameters(
    specs: list[ProcessSpec], robot: str, lockstep: bool, calibrations: Path, extra: Parameters
) -> dict[str, dict[str, object]]:
    """Parameters of every node: the robot, lockstep where it matters, and the caller's.

    Args:
        specs: Processes of the graph.
        robot: Profile, by name or path.
        lockstep: Whether the plant waits for the command of each tick.
        calibrations: Folder of the calibration files.
        extra: Further parameters by node; they go before all others.

    Raises:
        PoiseError: A node is unknown; the known ones are listed.
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
    if lockstep:
        for name in result.keys() & LOCKSTEP_NODES:
            result[name]["lockstep"] = True
    return result
