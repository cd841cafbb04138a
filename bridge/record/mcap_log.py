"""MCAP files of serialised ROS 2 messages, for Foxglove, PlotJuggler and ``ros2 bag``, and their topics."""

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
#: Recorded topics by their type; names without a slash are relative to the namespace of the robot
_TOPICS = {
    "sensor_msgs/msg/JointState": (
        *(topics.JOINT_STATES, topics.HEAD_COMMAND, topics.HEAD_STATE, topics.ENCODER_OFFSETS, topics.POSTURE),
    ),
    "sensor_msgs/msg/Imu": (topics.IMU_RAW, topics.IMU_DATA),
    "sensor_msgs/msg/LaserScan": (topics.SCAN,),
    "geometry_msgs/msg/WrenchStamped": (*topics.FOOT_WRENCHES, topics.EXTERNAL_WRENCH, topics.PUSH),
    "geometry_msgs/msg/Twist": (topics.CMD_VEL, topics.GAIT_VELOCITY),
    "geometry_msgs/msg/TwistStamped": (topics.CMD_VEL_STAMPED,),
    "geometry_msgs/msg/PoseStamped": (topics.GOAL_POSE,),
    "geometry_msgs/msg/Vector3Stamped": (topics.VISION_BEARING,),
    "trajectory_msgs/msg/JointTrajectory": (topics.JOINT_COMMAND, topics.MOTION_TRAJECTORY),
    "nav_msgs/msg/Odometry": (topics.ODOM, topics.GROUND_TRUTH),
    "nav_msgs/msg/Path": (topics.FOOTSTEPS, topics.FOOTSTEPS_TAKEN, topics.FOOTSTEPS_COMMAND),
    "tf2_msgs/msg/TFMessage": (topics.TF, topics.TF_STATIC),
    "rosgraph_msgs/msg/Clock": (topics.CLOCK,),
    "diagnostic_msgs/msg/DiagnosticArray": (DIAGNOSTICS,),
    "std_msgs/msg/UInt8MultiArray": (topics.CONTACTS,),
    "std_msgs/msg/Bool": (topics.VISION_DETECTED,),
    "std_msgs/msg/Empty": (topics.GAIT_STOP,),
    "std_msgs/msg/Float64": (topics.GAIT_CAPTURE_MARGIN,),
    "std_msgs/msg/String": (
        *(topics.APPLIED, topics.MODE, topics.DRIVER_STATE, topics.ROBOT_DESCRIPTION, topics.HUMANOID_COMMANDS),
        *(topics.COMMANDER, topics.GAIT_PHASE, topics.GAIT_ROUTE, topics.MOTION_REQUEST, topics.MOTION_PLAN_STATE),
        *(topics.MOTION_STATE, EVENTS),
    ),
}
TYPES = {topic: kind for kind, names in _TOPICS.items() for topic in names}  #: Type of each topic


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
