"""Connection to a robot behind ros2_control: a separate, polled participant in the robot's DDS domain."""

import time
from collections.abc import Mapping, Sequence
from math import inf
from typing import Any, Protocol

from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState

from bridge.plants.hardware import RobotConnection, real_robot
from bridge.plants.participant import SENSOR, Participant, ignore, take, take_all
from bridge.plants.ros2_control.config import COMMAND, FEET, IMU, JOINTS, STATE, Ros2ControlConfig
from models.nodes.interfaces import interface

#: Type of the messages of each source
TYPES = {JOINTS: JointState, IMU: Imu, **dict.fromkeys(FEET, WrenchStamped)}

Message = tuple[str, bytes]  #: Source and serialised message


class ControlLink(RobotConnection, Protocol):
    """A connection to a robot and its controller manager; ``take`` returns messages of the sources."""

    def controllers(self) -> Mapping[str, str] | None:
        """State of each loaded controller by name; None without an answer of the controller manager."""

    def joint_order(self) -> Sequence[str] | None:
        """Joints of linear_feedback_controller in its order; None while unknown, and for other controllers."""


class RosLink(Participant, ControlLink):
    """The robot over rclpy in its domain, with the transports of this process.

    ``command`` is the message type of the commands. Raises ``MessageError`` when a required type is not built.
    """

    def __init__(self, domain: int, config: Ros2ControlConfig, sources: Sequence[str], command: Any) -> None:
        listing = interface("controller_manager_msgs", "srv", "ListControllers") if config.controller_manager else None
        state = interface("linear_feedback_controller_msgs", "msg", "Sensor") if config.command == "feedback" else None
        topics, types = config.topic_of, {**TYPES, COMMAND: command}
        guard = COMMAND in sources
        super().__init__(domain, "poise_ros2_control", guard=guard)
        node = self._node
        self._readers = [
            (source, node.create_subscription(types[source], topics[source], ignore, SENSOR, raw=True))
            for source in sources
        ]
        self._echo: Any = None
        if not guard:  # a guard reads the commands as a source
            self._echo = node.create_subscription(command, topics[COMMAND], ignore, SENSOR, raw=True)
        reliable = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self._writer = node.create_publisher(command, topics[COMMAND], reliable)
        latest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._state = None if state is None else node.create_subscription(state, topics[STATE], ignore, latest)
        self._client = None
        if listing is not None:
            self._listing = listing
            self._client = node.create_client(listing, f"{config.manager}/list_controllers")
        self._shared = real_robot()
        self._asked = self._looked = self._answered = -inf
        self._controllers: dict[str, str] = {}
        self._order: list[str] | None = None

    def take(self) -> list[Message]:
        return [(source, data) for source, reader in self._readers for data in take_all(reader)]

    def send(self, data: bytes) -> None:
        self._writer.publish(data)

    def commands(self) -> list[bytes]:
        return [] if self._echo is None else take_all(self._echo)

    def controllers(self) -> Mapping[str, str] | None:
        if self._client is None:
            return None
        now = time.monotonic()
        if now - self._looked >= self._shared.look_period:
            self._looked = now
            self._exchange(now)
        return self._controllers if now - self._answered <= self._shared.answer_age_max else None

    def _exchange(self, now: float) -> None:
        """Take an answer of the controller manager, and send the next request when it is due."""
        client: Any = self._client
        with client.handle:
            _, answer = client.handle.take_response(self._listing.Response)
        if answer is not None:
            self._answered = now
            self._controllers = {each.name: each.state for each in answer.controller}
        if now - self._asked >= self._shared.ask_period and client.service_is_ready():
            self._asked = now
            with client.handle:
                client.handle.send_request(self._listing.Request())

    def joint_order(self) -> Sequence[str] | None:
        if self._state is not None and (message := take(self._state)) is not None:
            self._order = list(message.joint_state.name)
        return self._order
