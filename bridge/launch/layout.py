"""Layout of the graph: which nodes share a process, and the order of their activation."""

from collections.abc import Sequence
from typing import Literal

from bridge.ros.processes import ProcessSpec

Processes = Literal["shared", "separate"]  #: Whether gait planner, controller and estimator share one process
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


def process_specs(
    processes: Processes = "shared",
    *,
    actions: bool = False,
    camera: bool = False,
    terrain_map: bool = False,
    given_map: bool = False,
) -> list[ProcessSpec]:
    """Processes of the graph, the plant first.

    Both ``terrain_map`` and ``given_map`` add the mapping of the ground: from range sensors, or from a given map.
    """
    control = [CONTROL] if processes == "shared" else [GAIT, CONTROLLER, ESTIMATOR]
    mapping = [TERRAIN, GROUND] if terrain_map or given_map else []
    seeing = [*([CAMERA] if camera else []), *([RANGES] if terrain_map else []), *mapping]
    return [BRIDGE, *control, PLANNER, SUPERVISOR, *([ACTIONS] if actions else []), *seeing]


def activation_order(specs: Sequence[ProcessSpec]) -> list[str]:
    """Nodes in activation order: the order of the processes, with the plant last."""
    return [*(name for spec in specs for name in spec.nodes if name not in BRIDGE.nodes), *BRIDGE.nodes]
