"""Every node of the packages, for the reference and for tests that hold for all of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bridge.nodes.action_server import ActionServerNode
from bridge.nodes.camera_node import CameraNode
from bridge.nodes.mujoco_bridge import MujocoBridge
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.foot_sensor_node import FootSensorNode
from controllers.nodes.imu_node import ImuNode
from controllers.nodes.motor_controller import MotorControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from controllers.nodes.supervisor import SupervisorNode
from controllers.nodes.vision_node import VisionNode
from models.nodes.base import PoiseNode
from planners.nodes.gait_planner import GaitPlannerNode
from planners.nodes.motion_planner import MotionPlannerNode

NODES: Mapping[str, type[Any]] = {
    "mujoco_bridge": MujocoBridge,
    "state_estimator": StateEstimatorNode,
    "balance_controller": BalanceControllerNode,
    "gait_planner": GaitPlannerNode,
    "motion_planner": MotionPlannerNode,
    "supervisor": SupervisorNode,
    "action_server": ActionServerNode,
    "imu_node": ImuNode,
    "foot_sensor_node": FootSensorNode,
    "motor_controller": MotorControllerNode,
    "camera_node": CameraNode,
    "vision_node": VisionNode,
}
"""Class of each node by its default name."""

OF_RCLPY = frozenset({"use_sim_time", "start_type_description_service"})
"""Parameters that rclpy declares in every node."""


def parameters(node: PoiseNode) -> dict[str, Any]:
    """Descriptor of each parameter that a node has declared itself, by name."""
    names = [name for name in node.get_parameters_by_prefix("") if name not in OF_RCLPY]
    return dict(zip(names, node.describe_parameters(names), strict=True))
