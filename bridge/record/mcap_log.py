"""MCAP files of serialised ROS 2 messages, for Foxglove, PlotJuggler and ``ros2 bag``, and their topics."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from mcap.writer import Writer

from models.files import part_beside
from models.nodes import topics
from models.nodes.message_text import message_text

DESCRIPTION, ROBOT = "poise", "robot"  #: Metadata record of the file, and its key with the name of the robot's profile
DIAGNOSTICS = "/diagnostics"
EVENTS = "events"  #: Events of the closed loop as text
_TEXT, _TWIST, _PATH = "std_msgs/msg/String", "geometry_msgs/msg/Twist", "nav_msgs/msg/Path"
_JOINTS, _TRAJECTORY = "sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory"

#: Type of each topic; names without a slash are relative to the namespace of the robot
TYPES = {
    topics.JOINT_STATES: _JOINTS,
    topics.IMU_RAW: "sensor_msgs/msg/Imu",
    topics.IMU_DATA: "sensor_msgs/msg/Imu",
    **dict.fromkeys(topics.FOOT_WRENCHES, "geometry_msgs/msg/WrenchStamped"),
    topics.JOINT_COMMAND: _TRAJECTORY,
    topics.APPLIED: _TEXT,
    topics.ODOM: "nav_msgs/msg/Odometry",
    topics.CONTACTS: "std_msgs/msg/UInt8MultiArray",
    topics.EXTERNAL_WRENCH: "geometry_msgs/msg/WrenchStamped",
    topics.GROUND_TRUTH: "nav_msgs/msg/Odometry",
    topics.TF: "tf2_msgs/msg/TFMessage",
    topics.TF_STATIC: "tf2_msgs/msg/TFMessage",
    topics.HEAD_COMMAND: _JOINTS,
    topics.HEAD_STATE: _JOINTS,
    topics.VISION_BEARING: "geometry_msgs/msg/Vector3Stamped",
    topics.VISION_DETECTED: "std_msgs/msg/Bool",
    topics.MODE: _TEXT,
    topics.DRIVER_STATE: _TEXT,
    topics.ENCODER_OFFSETS: _JOINTS,
    topics.ROBOT_DESCRIPTION: _TEXT,
    topics.CLOCK: "rosgraph_msgs/msg/Clock",
    topics.HUMANOID_COMMANDS: _TEXT,
    topics.COMMANDER: _TEXT,
    topics.CMD_VEL: _TWIST,
    topics.CMD_VEL_STAMPED: "geometry_msgs/msg/TwistStamped",
    topics.GAIT_VELOCITY: _TWIST,
    topics.GAIT_STOP: "std_msgs/msg/Empty",
    topics.GAIT_PHASE: _TEXT,
    topics.GAIT_ROUTE: _TEXT,
    topics.GAIT_CAPTURE_MARGIN: "std_msgs/msg/Float64",
    topics.FOOTSTEPS: _PATH,
    topics.FOOTSTEPS_TAKEN: _PATH,
    topics.FOOTSTEPS_COMMAND: _PATH,
    topics.GOAL_POSE: "geometry_msgs/msg/PoseStamped",
    topics.MOTION_REQUEST: _TEXT,
    topics.MOTION_PLAN_STATE: _TEXT,
    topics.MOTION_STATE: _TEXT,
    topics.MOTION_TRAJECTORY: _TRAJECTORY,
    topics.POSTURE: _JOINTS,
    topics.SCAN: "sensor_msgs/msg/LaserScan",
    topics.PUSH: "geometry_msgs/msg/WrenchStamped",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    EVENTS: _TEXT,
}


class McapLog:
    """Serialised messages with their definitions; the file appears at ``close``. ``PoiseError`` when not writable."""

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, part_beside(path)
        self._file = self._part.open("wb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library=f"poise {version('poise')}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self.counts: dict[str, int] = {}

    def announce(self, topic: str, kind: str) -> None:
        """Declare the type of a topic before its first message; ``MessageError`` when it is not installed."""
        if kind not in self._schemas:
            text = message_text(kind)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        self.counts[topic] = 0

    def add(self, topic: str, data: bytes, stamp: int, sent: int | None = None) -> None:
        """Write a serialised message at a log time [ns]; ``sent`` is the publish time [ns], if different."""
        count = self.counts[topic]
        self._writer.add_message(self._channels[topic], stamp, data, stamp if sent is None else sent, count)
        self.counts[topic] = count + 1

    def describe(self, name: str, data: Mapping[str, str]) -> None:
        """Write metadata."""
        self._writer.add_metadata(name, dict(data))

    def close(self) -> None:
        """Complete the file and move it to its path."""
        self._writer.finish()
        self._file.close()
        self._part.replace(self._path)

    def discard(self) -> None:
        """Delete the incomplete file."""
        self._file.close()
        self._part.unlink()
