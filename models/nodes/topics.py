"""Names of the graph: topics, frames, services and state words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from models.constants import FOOT_NAMES

if TYPE_CHECKING:  # the command line must not load Pinocchio for a name
    from models.robot_model import RobotModel

JOINT_STATES = "joint_states"
IMU_RAW = "imu/data_raw"
IMU_DATA = "imu/data"
IMU_FILTERED = "imu/data_filtered"
FOOT_WRENCHES = tuple(f"foot/{name}/wrench" for name in FOOT_NAMES)
FOOT_CONTACTS = tuple(f"foot/{name}/contact" for name in FOOT_NAMES)
FOOT_COPS = tuple(f"foot/{name}/cop" for name in FOOT_NAMES)
ODOM = "odom"
CONTACTS = "contacts"
CONTACT_WRENCHES = tuple(f"contacts/{name}/wrench" for name in FOOT_NAMES)  #: Wrenches of the state estimator
GROUND_FRICTION = "ground/friction"  #: Estimated Coulomb coefficient under the soles
EXTERNAL_WRENCH = "external_wrench"
MOTOR_COMMANDS, MOTOR_STATE = "motor_commands", "motor_controller/state"
JOINT_SETPOINTS = "joint_setpoints"  #: From the balance controller to the drivers: one point per tick
JOINT_TRAJECTORY = "joint_trajectory_controller/joint_trajectory"  #: From a user, executed while balancing
APPLIED = "control/applied"
MODE = "mode"
DRIVER_STATE = "driver_state"
ENCODER_OFFSETS = "encoder_offsets"
ROBOT_DESCRIPTION = "robot_description"
REAL_TIME_FACTOR = "real_time_factor"
CLOCK = "/clock"
GROUND_TRUTH = "ground_truth/odom"
PUSH = "push"
FAULTS_INJECT, FAULTS_CLEAR = "faults/inject", "faults/clear"
GROUND_TRUTH_JOINTS, GROUND_TRUTH_OBSTACLE = "ground_truth/joint_states", "ground_truth/obstacle"
SCAN = "scan"
CAMERA_IMAGE, CAMERA_INFO, CAMERA_TARGET = "camera/image_raw", "camera/camera_info", "camera/target"
DEPTH_IMAGE, DEPTH_INFO, DEPTH_POINTS = "depth/image_rect_raw", "depth/camera_info", "depth/points"
LIDAR_POINTS = "lidar/points"
TERRAIN_MAP, TERRAIN_PATCHES = "terrain/grid_map", "terrain/patches"
VISION_BEARING, VISION_DETECTED = "vision/bearing", "vision/detected"
HEAD_COMMAND, HEAD_STATE = "head/pan_tilt", "head/state"
HUMANOID_COMMANDS, TEXT_COMMAND = "humanoid_commands", "text_command"  #: Two topic names for text commands
MOTION_REQUEST = "motion/request"
MOTION_PLAN_STATE = "motion/plan_state"
MOTION_TRAJECTORY = "motion/joint_trajectory"
MOTION_STATE = "motion/state"
POSTURE = "balance_controller/posture"
CMD_VEL, CMD_VEL_STAMPED = "cmd_vel", "cmd_vel_stamped"
GAIT_VELOCITY, GAIT_STOP = "gait/velocity_request", "gait/stop"
COMMANDER, LOCKS = "commands/active", "locks"
GAIT_PHASE = "gait/phase"
GAIT_COMMAND, GAIT_STATE = "gait/command", "gait/state"  #: Between gait planner and controller in separate processes
GROUND_REQUEST, GROUND_PLAN = "gait/ground_request", "gait/ground_plan"  #: Between gait planner and ground planner
GAIT_CAPTURE_MARGIN = "gait/capture_margin"
FOOTSTEPS, FOOTSTEPS_TAKEN = "gait/footsteps", "gait/footsteps_taken"
GOAL_POSE, FOOTSTEPS_COMMAND = "goal_pose", "gait/footsteps_command"
GAIT_ROUTE = "gait/route"
PLAN_FOOTSTEPS, PLAN_TIMED_FOOTSTEPS = "plan_footsteps", "gait/plan_footsteps"
PLAN_MOTION = "plan_motion"
CALIBRATE = "calibrate"

TF, TF_STATIC = "/tf", "/tf_static"

ODOM_FRAME, BASE_FRAME, FOOTPRINT_FRAME = "odom", "base_link", "base_footprint"
IMU_FRAME = "imu"

#: Values of ``driver_state``: held by the simulator, hanging, lowering on request, or state of the joint drivers
HELD, HANGING, RELAXING, ACTIVE, DAMPED, OFF = "held", "hanging", "relaxing", "active", "damped", "off"
#: Values of ``gait/phase``: the robot cannot walk, or stands still; other values name the phase of a walk
GAIT_ABSENT, GAIT_SETTLED = "absent", "settled"
CONTROL_STATUS, ESTIMATOR_STATUS = "balance_controller/status", "state_estimator/status"
GAIT_STATUS, ROUTE_STATUS, MOTION_STATUS = "gait/status", "gait/route_status", "motion/status"
SUPERVISOR_STATUS, NODE_STATUS = "supervisor/status", "node_status"  #: Records of ``models/status.py``
SUPERVISOR_TIME = "supervisor/time"  #: Time up to which the supervisor has received the state
PERCEPTION_TIME = "perception/time"  #: Time up to which each perception node has done its work
START_STATUS = "start/status"  #: Record of the start-up of a real robot
#: Services for the operator of a real robot
START = "start/"  #: Prefix of these services
START_RELAX = f"{START}relax"
START_SERVICES = (*(f"{START}{step}" for step in ("confirm_gantry", "prepare", "lower")), START_RELAX, f"{START}damp")
REFUSALS = "refusals"  #: Latest refusals of each node, with reason
STOP_MOTION = "stop"  #: ``motion/request`` that asks the controller to hold the present posture


def source_topics(source: str) -> tuple[str, str]:
    """Topics of text commands and velocities of a command source."""
    return f"commands/{source}", f"commands/{source}/cmd_vel"


def foot_wrenches(model: RobotModel) -> tuple[str, ...]:
    """Topics of the foot sensors; empty for a robot without foot sensors."""
    return FOOT_WRENCHES if model.profile.sensors.feet.fitted else ()


def sensor_topics(model: RobotModel) -> tuple[str, ...]:
    """Topics of joint states, IMU and foot sensors of a robot."""
    return (JOINT_STATES, IMU_RAW, *foot_wrenches(model))


def needed_topics(model: RobotModel) -> tuple[str, ...]:
    """Topics that a robot needs to stand: sensors, states, descriptions and commands."""
    states = (ODOM, POSTURE, MODE, DRIVER_STATE, ENCODER_OFFSETS, CLOCK)
    return (*sensor_topics(model), *states, ROBOT_DESCRIPTION, JOINT_SETPOINTS)
