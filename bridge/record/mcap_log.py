"""Topics and MCAP files of serialised ROS 2 messages, for Foxglove, PlotJuggler and ``ros2 bag``."""

import json
import os
import sysconfig
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path

from mcap.writer import Writer

from models.errors import MessageError
from models.files import part_beside
from models.nodes import topics

DESCRIPTION, ROBOT = "poise", "robot"  #: Metadata record of the file, and the key of the robot's profile name in it
DIAGNOSTICS = "/diagnostics"
EVENTS = "events"  #: Events of the closed loop as text
#: Recorded topics by type; names without a slash are relative to the namespace of the robot
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
    "trajectory_msgs/msg/JointTrajectory": (topics.JOINT_SETPOINTS, topics.JOINT_TRAJECTORY, topics.MOTION_TRAJECTORY),
    "nav_msgs/msg/Odometry": (topics.ODOM, topics.GROUND_TRUTH),
    "nav_msgs/msg/Path": (topics.FOOTSTEPS, topics.FOOTSTEPS_TAKEN, topics.FOOTSTEPS_COMMAND),
    "tf2_msgs/msg/TFMessage": (topics.TF, topics.TF_STATIC),
    "rosgraph_msgs/msg/Clock": (topics.CLOCK,),
    "diagnostic_msgs/msg/DiagnosticArray": (DIAGNOSTICS,),
    "diagnostic_msgs/msg/DiagnosticStatus": (topics.REFUSALS,),
    "std_msgs/msg/UInt8MultiArray": (topics.CONTACTS,),
    "std_msgs/msg/Bool": (topics.VISION_DETECTED,),
    "std_msgs/msg/Empty": (topics.GAIT_STOP,),
    "std_msgs/msg/Float64": (topics.GAIT_CAPTURE_MARGIN, topics.GROUND_FRICTION),
    "std_msgs/msg/String": (
        *(topics.APPLIED, topics.MODE, topics.DRIVER_STATE, topics.ROBOT_DESCRIPTION, topics.HUMANOID_COMMANDS),
        *(topics.COMMANDER, topics.GAIT_PHASE, topics.GAIT_ROUTE, topics.MOTION_REQUEST, topics.MOTION_PLAN_STATE),
        *(topics.MOTION_STATE, EVENTS),
    ),
}
TYPES = {topic: kind for kind, names in _TOPICS.items() for topic in names}  #: Type of each topic
_FOREVER = {"sec": 9223372036, "nsec": 854775807}
#: Offered QoS in the format of ``ros2 bag record`` of Jazzy; rosbag2 expects YAML, and JSON is valid YAML
_LATCHED = json.dumps(
    [
        {
            **{"history": "keep_last", "depth": 10, "reliability": "reliable", "durability": "transient_local"},
            **{"deadline": _FOREVER, "lifespan": _FOREVER, "liveliness": "automatic"},
            **{"liveliness_lease_duration": _FOREVER, "avoid_ros_namespace_conventions": False},
        }
    ]
)


class McapLog:
    """Writes serialised messages with definitions; ``close`` completes the file. ``PoiseError`` if not writable."""

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, part_beside(path)
        self._file = self._part.open("wb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library=f"poise {version('poise')}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self.counts: dict[str, int] = {}

    def announce(self, topic: str, kind: str, *, latched: bool = False) -> None:
        """Declare the type of a topic before its first message; ``MessageError`` when the type is not installed.

        ``ros2 bag play`` publishes a ``latched`` topic as transient local, any other topic as volatile.
        """
        if kind not in self._schemas:
            text = message_text(kind)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        offered = {"offered_qos_profiles": _LATCHED} if latched else {}
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind], offered)
        self.counts[topic] = 0

    def add(self, topic: str, data: bytes, stamp: int, sent: int | None = None) -> None:
        """Write a serialised message at a log time [ns]; ``sent`` is the publish time [ns], if different."""
        count = self.counts[topic]
        self._writer.add_message(self._channels[topic], stamp, data, stamp if sent is None else sent, count)
        self.counts[topic] = count + 1

    def describe(self, name: str, data: Mapping[str, str]) -> None:
        """Write metadata."""
        self._writer.add_metadata(name, dict(data))

    def close(self, *, keep: bool = True) -> None:
        """Complete the file and move it to its path, or delete it."""
        if keep:
            self._writer.finish()
        self._file.close()
        if keep:
            self._part.replace(self._path)
        else:
            self._part.unlink()


_RULE = 80 * "="


def message_text(name: str) -> str:
    """Definition of a message and of all nested messages (``ros2msg`` of MCAP); ``MessageError`` when not installed."""
    own, *others = _closure(name)
    parts = [f"\n{_RULE}\nMSG: {other.replace('/msg/', '/')}\n{_text(other)}" for other in others]
    return "".join([_text(own), *parts])


@cache
def _text(name: str) -> str:
    sourced = [prefix for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    for prefix in (*sourced, sysconfig.get_path("data")):  # wheels use the share folder of the environment
        path = Path(prefix) / "share" / f"{name}.msg"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    raise MessageError(f"{name}: its definition is not installed")


def _closure(name: str) -> list[str]:
    found = [name]
    for each in found:
        package = each.partition("/")[0]
        for line in _text(each).splitlines():
            words = line.partition("#")[0].split()
            kind = words[0].partition("[")[0] if words else ""
            if not kind[:1].isupper() and "/" not in kind:
                continue  # a primitive type
            where, _, short = kind.rpartition("/")
            full = f"{where.removesuffix('/msg') or package}/msg/{short}"
            if full not in found:
                found.append(full)
    return found
