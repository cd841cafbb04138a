"""What a user of ROS 2 does with a humanoid: command lines, and what has to come back."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Step:
    """One command line in a shell of its own.

    Attributes:
        command: What stands after ``ros2``.
        shows: Patterns, each found in its output.
        meanwhile: Step done while this one runs, once it has shown that.
        then: Patterns found in its output after that.
        stop: Whether Ctrl-C ends it.
        again: Whether it only looks, and looks again until it shows that: what is new takes time to be discovered.
    """

    command: str
    shows: tuple[str, ...] = ()
    meanwhile: Step | None = None
    then: tuple[str, ...] = ()
    stop: bool = False
    again: bool = False


NODES = ("balance_controller", "gait_planner", "motion_planner", "robot_driver", "state_estimator", "supervisor")

GAIN = "/balance_controller balance.dcm_gain"

TOPICS = (
    ("/joint_states", "sensor_msgs/msg/JointState"),
    ("/imu/data", "sensor_msgs/msg/Imu"),
    ("/odom", "nav_msgs/msg/Odometry"),
    ("/tf", "tf2_msgs/msg/TFMessage"),
    ("/tf_static", "tf2_msgs/msg/TFMessage"),
    ("/robot_description", "std_msgs/msg/String"),
    ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
    ("/clock", "rosgraph_msgs/msg/Clock"),
    ("/cmd_vel", "geometry_msgs/msg/Twist"),
    ("/joint_setpoints", "trajectory_msgs/msg/JointTrajectory"),
    ("/joint_trajectory_controller/joint_trajectory", "trajectory_msgs/msg/JointTrajectory"),
)

ACTIONS = (
    ("/execute_motion", "poise_interfaces/action/ExecuteMotion"),
    ("/walk_to", "poise_interfaces/action/WalkTo"),
    ("/joint_trajectory_controller/follow_joint_trajectory", "control_msgs/action/FollowJointTrajectory"),
)

AHEAD = "{goal: {header: {frame_id: odom}, pose: {position: {x: 3.0}, orientation: {w: 1.0}}}}"

WAIST = (
    "{trajectory: {joint_names: [waist_yaw_joint], points: [{positions: [0.0], velocities: [0.0]},"
    " {positions: [0.2], velocities: [0.0], time_from_start: {sec: 2}}]}}"
)

CANCEL = "/walk_to/_action/cancel_goal action_msgs/srv/CancelGoal"
"""The service behind every action: Ctrl-C at the ``send_goal`` of ros2cli 0.32.2 does not cancel."""

DEFAULT_QOS = "--qos-reliability reliable --qos-durability volatile --qos-history keep_last --qos-depth 10"
"""QoS of a textbook subscriber: ``create_subscription(kind, topic, callback, 10)``."""

ARM = "{joint_names: [left_shoulder_roll, left_elbow], points: [{positions: [0.4, 0.6], time_from_start: {sec: 1}}]}"
UNKNOWN_JOINT = "{joint_names: [left_sholder_roll], points: [{positions: [0.4], time_from_start: {sec: 1}}]}"
VELOCITY = "/cmd_vel geometry_msgs/msg/Twist"
TRAJECTORY = "/joint_trajectory_controller/joint_trajectory trajectory_msgs/msg/JointTrajectory"

LAUNCH = "launch bridge humanoid.launch.py robot:=g1"


def lines(pairs: tuple[tuple[str, str], ...]) -> tuple[str, ...]:
    """Patterns of the lines of ``list -t``."""
    return tuple(rf"(?m)^{name} \[{kind}\]$" for name, kind in pairs)


BEFORE = (
    Step("pkg prefix controllers", (r"(?m)^/",)),
    Step("pkg executables controllers", ("controllers balance_controller", "controllers supervisor")),
    Step("pkg executables planners", ("planners motion_planner",)),
    Step("pkg executables bridge", ("bridge robot_driver", "bridge poise")),
    Step("interface show sensor_msgs/msg/Imu", ("geometry_msgs/Quaternion orientation",)),
    Step("interface show poise_interfaces/action/WalkTo", ("geometry_msgs/PoseStamped goal",)),
    Step("launch bridge humanoid.launch.py --show-args", ("'robot':", "'namespace':")),
)
"""Steps without a robot."""

STEPS = (
    Step("node list", tuple(rf"(?m)^/{name}$" for name in NODES), again=True),
    Step("node info /supervisor", ("/humanoid_commands: std_msgs/msg/String", "/mode: std_msgs/msg/String")),
    Step("topic list -t", lines(TOPICS), again=True),
    Step("topic info -v /odom", ("Node name: state_estimator", "Reliability: RELIABLE"), again=True),
    Step("topic info -v /robot_description", ("Reliability: RELIABLE", "Durability: TRANSIENT_LOCAL"), again=True),
    Step("topic echo --once /joint_states", ("left_knee_joint", "position:")),
    Step(f"topic echo --once {DEFAULT_QOS} /joint_states", ("left_knee_joint",)),
    Step(f"topic echo --once {DEFAULT_QOS} /imu/data", ("frame_id: imu", "orientation:")),
    Step(f"topic echo --once {DEFAULT_QOS} /odom", ("child_frame_id: base_link",)),
    Step("topic echo --once /robot_description", ("data: .*<",)),
    Step("topic echo --once /diagnostics", ("name: ", "level: ")),
    Step("topic echo --once /tf", ("frame_id: odom", "child_frame_id: base_link")),
    Step("topic hz /odom", (r"average rate: \d+",), stop=True),
    Step("service list -t", lines((("/mode/stand", "std_srvs/srv/Trigger"),)), again=True),
    Step("service list -t", lines((("/set_mode", "poise_interfaces/srv/SetMode"),)), again=True),
    Step("service call /mode/stand std_srvs/srv/Trigger", ("success=True", "already in mode 'stand'")),
    Step("service call /set_mode poise_interfaces/srv/SetMode '{mode: stand}'", ("success=True",)),
    Step("service call /set_mode poise_interfaces/srv/SetMode '{mode: fly}'", ("success=False", "fly")),
    Step("lifecycle get /balance_controller", (r"active \[3\]",)),
    Step("param list /balance_controller", (r"(?m)^ +balance\.dcm_gain$", r"(?m)^ +robot$")),
    Step(f"param describe {GAIN}", ("Description: Feedback of the DCM error", "Min value: 2.5", "Max value: 10.0")),
    Step("param describe /balance_controller robot", ("(?i)read only: true",)),
    Step(f"param get {GAIN}", ("is: 5.0",)),
    Step(f"param set {GAIN} 6.0", ("Set parameter successful",)),
    Step(f"param get {GAIN}", ("is: 6.0",)),
    Step(f"param set {GAIN} 60.0", ("Setting parameter failed", "out of range")),
    Step("param set /balance_controller robot talos", ("Setting parameter failed", "read-only parameter")),
    Step(f"param get {GAIN}", ("is: 6.0",)),
    Step(
        "topic echo /mode",
        ("data: stand",),
        Step("topic pub --once /humanoid_commands std_msgs/msg/String '{data: wave}'", ("publishing #1",)),
        (r"(?s)data: motion.*data: stand",),
        stop=True,
    ),
    Step(
        "topic echo /mode",
        ("data: stand",),
        Step(
            "topic pub --rate 10 --times 30 /cmd_vel geometry_msgs/msg/Twist '{linear: {x: 0.3}}'", ("publishing #30",)
        ),
        (r"(?s)data: walk",),
        stop=True,
    ),
    Step(f"topic pub --times 3 {VELOCITY} '{{}}'", ("publishing #3",)),
    Step("topic echo --once /mode", ("data: stand",), again=True),
    Step(
        "topic echo --field data /motion/state",
        meanwhile=Step(f"topic pub --once {TRAJECTORY} '{ARM}'", ("publishing #1",)),
        then=("running", "done"),
        stop=True,
    ),
    Step(
        "topic echo --qos-durability transient_local --qos-reliability reliable /refusals",
        meanwhile=Step(f"topic pub --once {TRAJECTORY} '{UNKNOWN_JOINT}'", ("publishing #1",)),
        then=("did you mean '+left_shoulder_roll_joint",),
        stop=True,
    ),
    Step("action list -t", lines(ACTIONS), again=True),
    Step(
        "action send_goal --feedback /execute_motion poise_interfaces/action/ExecuteMotion '{motion: squat}'",
        ("Goal accepted", "Feedback:", "state: running", "success: true", "status: SUCCEEDED"),
    ),
    Step(
        "action send_goal --feedback /joint_trajectory_controller/follow_joint_trajectory"
        f" control_msgs/action/FollowJointTrajectory '{WAIST}'",
        ("Goal accepted", "Feedback:", "error_code: 0", "status: SUCCEEDED"),
    ),
    Step(
        f"action send_goal --feedback /walk_to poise_interfaces/action/WalkTo '{AHEAD}'",
        ("Goal accepted", "Feedback:", "route: .?running"),
        Step(f"service call {CANCEL} '{{}}'", (r"goals_canceling=\[.*GoalInfo",)),
        ("status: CANCELED",),
    ),
    Step("topic echo --once /mode", ("data: stand",), again=True),
    Step(
        "run controllers imu_node --ros-args -r __node:=my_imu_node -p rate:=50.0",
        meanwhile=Step("lifecycle get /my_imu_node", (r"active \[3\]",), again=True),
        stop=True,
    ),
)
"""Steps with a robot that stands."""
