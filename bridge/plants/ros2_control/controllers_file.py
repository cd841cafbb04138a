"""Writes the parameter file of the controller manager for a robot's profile and the options of the plant."""

from typing import Any

import yaml

from bridge.plants.ros2_control.commands import PVT
from bridge.plants.ros2_control.config import COMMAND, FEET, IMU, JOINTS, Ros2ControlConfig, sources
from bridge.plants.ros2_control.sensors import FIELDS
from models.robot_model import SOLE_FRAMES, RobotModel

ESTIMATOR = "joint_state_estimator"  #: Controller that supplies the state to linear_feedback_controller
_TYPES = {
    JOINTS: "joint_state_broadcaster/JointStateBroadcaster",
    IMU: "imu_sensor_broadcaster/IMUSensorBroadcaster",
    **dict.fromkeys(FEET, "force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster"),
}
_COMMAND_TYPES = {
    "effort": "effort_controllers/JointGroupEffortController",
    "pvt": "gpio_controllers/GpioCommandController",
    "feedback": "linear_feedback_controller/LinearFeedbackController",
}
_HEADER = """\
# Written by 'poise controllers' for the profile {robot}. Yours to set:
# sensor_name: the <sensor> of your URDF's ros2_control tag;
# frame_id: the link of the URDF in whose axes the sensor measures;
# offset and multiplier of foot sensors: they must give the force of the ground on the robot.
"""


def controllers_file(model: RobotModel, config: Ros2ControlConfig) -> str:
    """YAML of broadcasters and command controller; joints are in the order of the plant's commands."""
    names, joints = config.controllers, list(model.joint_names)
    used = {names[source]: _TYPES[source] for source in sources(model)}
    used[names[COMMAND]] = _COMMAND_TYPES[config.command]
    if config.command == "feedback" and not config.free_flyer:
        used[ESTIMATOR] = "linear_feedback_controller/JointStateEstimator"
    imu, manager = model.profile.frames["imu"], config.controller_manager or "controller_manager"
    moved = any((*imu.xyz, *imu.rpy))
    parameters: dict[str, Any] = {
        manager: {
            "update_rate": round(config.rate),
            **{name: {"type": kind} for name, kind in used.items()},
        },
        names[JOINTS]: {"joints": joints, "interfaces": list(FIELDS), "publish_dynamic_joint_states": False},
        names[IMU]: {"sensor_name": "imu", "frame_id": "imu" if moved else imu.link},
    }
    for source, sole in zip(FEET, SOLE_FRAMES, strict=True):
        if source in sources(model):
            parameters[names[source]] = {"sensor_name": source, "frame_id": sole}
    parameters |= _command_parameters(model, config)
    full = config.full_name if config.namespace else str
    nodes = {full(name): {"ros__parameters": given} for name, given in parameters.items()}
    return _HEADER.format(robot=model.name) + yaml.dump(nodes, Dumper=_Dumper, sort_keys=False)


class _Dumper(yaml.SafeDumper):
    """Writes no anchors, which parameter files of ROS 2 do not support."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _command_parameters(model: RobotModel, config: Ros2ControlConfig) -> dict[str, Any]:
    """Parameters of the command controller and of the controllers that it needs."""
    name, joints = config.controllers[COMMAND], list(model.joint_names)
    if config.command == "effort":
        return {name: {"joints": joints}}
    if config.command == "pvt":
        commanded = {joint: {"interfaces": list(PVT)} for joint in joints}
        measured = {joint: {"interfaces": ["position"]} for joint in joints}
        return {name: {"gpios": joints, "command_interfaces": commanded, "state_interfaces": measured}}
    state = [f"{joint}/{field}" for field in FIELDS for joint in joints]
    damping = {joint: {"p": 0.0, "d": float(kd)} for joint, kd in zip(joints, model.kd, strict=True)}
    feedback = {
        "moving_joint_names": joints,
        "chainable_controller": {"command_interfaces": [f"{joint}/effort" for joint in joints], "reference_prefix": ""},
        "robot_has_free_flyer": config.free_flyer,
        "joint_velocity_filter_coefficient": 1.0,
        "pd_to_lf_transition_duration": 0.0,
        "remove_gravity_compensation_effort": False,
        **damping,
    }
    if config.free_flyer:  # needs an estimator of the base, which also supplies the joints
        return {name: feedback}
    return {
        name: feedback,
        ESTIMATOR: {"state_interfaces": state, "command_interfaces": [f"{name}/{each}" for each in state]},
    }
