"""A polled participant in a robot's DDS domain: a node without executor, parameters and logs."""

import time
from abc import abstractmethod
from math import inf
from typing import Any, NamedTuple

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from std_msgs.msg import Bool

from bridge.plants.hardware import real_robot, session
from bridge.plants.low_level import LowLink
from models.nodes.interfaces import interface
from models.nodes.spin import log_arguments

QUEUE = 32  #: Queue depth: messages kept between two ticks
SENSOR = QoSProfile(depth=QUEUE, reliability=ReliabilityPolicy.BEST_EFFORT)


def join(domain: int, name: str) -> tuple[Context, Node]:
    """Create a context in a DDS domain and a node in it, without parameters, logs and services."""
    context = Context()
    rclpy.init(args=log_arguments(), context=context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(
        name,
        context=context,
        use_global_arguments=False,
        enable_rosout=False,
        start_parameter_services=False,
        parameter_overrides=[Parameter("start_type_description_service", value=False)],
    )
    return context, node


def take_all(subscription: Any) -> list[bytes]:
    """Serialised messages of a raw subscription since the last call, oldest first, at most ``QUEUE``."""
    found: list[bytes] = []
    while len(found) < QUEUE and (data := take(subscription)) is not None:
        found.append(bytes(data))
    return found


def take_stamped(subscription: Any) -> list[tuple[bytes, int, int]]:
    """As ``take_all``, with the source time [ns] and the publisher's sequence number of each message."""
    found: list[tuple[bytes, int, int]] = []
    with subscription.handle:
        while len(found) < QUEUE and (taken := subscription.handle.take_message(subscription.msg_type, True)):
            data, info = taken
            found.append((bytes(data), info["source_timestamp"], info["publication_sequence_number"] or 0))
    return found


def take(subscription: Any) -> Any:
    """Next message of a subscription, serialised for a raw subscription; None without a message."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return None if taken is None else taken[0]


def ignore(message: Any) -> None:
    """Callback of polled subscriptions; never called."""


class Participant:
    """A node in the robot's domain, made by ``join``.

    The node of a ``guard`` publishes heartbeats; the node of the driver of the same graph subscribes to them.
    """

    def __init__(self, domain: int, name: str, *, guard: bool = False) -> None:
        self._context, self._node = join(domain, name)
        topic = f"poise_guard_{session():08x}"  # excludes the guards of other graphs
        self._beats: Any
        if guard:
            self._beats = self._node.create_publisher(Bool, topic, SENSOR)
        else:
            self._beats = self._node.create_subscription(Bool, topic, ignore, SENSOR)

    def beats(self) -> list[bool]:
        """Heartbeats of the guard since the last call; each is whether the guard is armed."""
        found: list[bool] = []
        while len(found) < QUEUE and (beat := take(self._beats)) is not None:
            found.append(bool(beat.data))
        return found

    def beat(self, armed: bool) -> None:
        """Publish a heartbeat of the guard."""
        self._beats.publish(Bool(data=armed))

    def close(self) -> None:
        """Leave the robot's domain."""
        self._node.destroy_node()
        try_shutdown(context=self._context)


class Topics(NamedTuple):
    """Message packages, types and topics of a robot's states, commands and service."""

    package: str  # with the types LowState and LowCmd
    state: str
    command: str
    service: str  # package of the request and response types
    types: tuple[str, str]
    requests: str
    responses: str


class ServiceLink(Participant, LowLink):
    """A robot over rclpy in its domain; a service over two topics reports its active controller.

    The service is polled every ``ask_period`` [s]. For ``answer_age_max`` after a request that changes the controller,
    each answer triggers the next poll. The controller is unknown ``answer_age_max`` after the last answer. The
    transports are those of this process. Raises ``MessageError`` when the message types are not built.
    """

    def __init__(self, domain: int, name: str, topics: Topics, ask_period: float | None = None) -> None:
        state, command = (interface(topics.package, "msg", each) for each in ("LowState", "LowCmd"))
        self._request, response = (interface(topics.service, "msg", each) for each in topics.types)
        super().__init__(domain, name)
        node, reliable = self._node, QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self._states = node.create_subscription(state, topics.state, ignore, SENSOR, raw=True)
        self._echo = node.create_subscription(command, topics.command, ignore, SENSOR, raw=True)
        self._responses = node.create_subscription(response, topics.responses, ignore, SENSOR)
        self._commands = node.create_publisher(command, topics.command, reliable)
        self._requests = node.create_publisher(self._request, topics.requests, reliable)
        self._topics, self._config = topics, real_robot()
        self._ask_period = self._config.ask_period if ask_period is None else ask_period
        self._looked = self._asked = self._answered = self._changed = -inf
        self._vendor = ""

    def take(self) -> list[Any]:
        return take_all(self._states)

    def send(self, data: bytes) -> None:
        self._commands.publish(data)

    def commands(self) -> list[bytes]:
        return take_all(self._echo)

    def vendor(self) -> str | None:
        now = time.monotonic()
        if now - self._looked >= self._config.look_period:
            self._looked = now
            while (response := take(self._responses)) is not None:
                if (name := self._name_in(response)) is not None:
                    self._vendor, self._answered = name, now
            changing = now - self._changed < self._config.answer_age_max and self._answered >= self._asked
            if (changing or now - self._asked >= self._ask_period) and self._reachable:
                self._asked = now
                self._ask()
        return self._vendor if now - self._answered <= self._config.answer_age_max else None

    @property
    def _reachable(self) -> bool:
        """Whether both topics of the service are matched; a request before that gets no answer."""
        return bool(self._requests.get_subscription_count() and self._node.count_publishers(self._topics.responses))

    def _may_change(self) -> bool:
        """Whether a request that changes the robot's controller may be sent: at most one per ``ask_period``."""
        now = time.monotonic()
        if now - self._changed < self._config.ask_period or not self._reachable:
            return False
        self._changed = now
        return True

    @abstractmethod
    def _ask(self) -> None:
        """Request the name of the active controller."""

    @abstractmethod
    def _name_in(self, response: Any) -> str | None:
        """Name of the active controller in the response to the last ``_ask``, empty for none; None for any other."""


class CommandLink(Participant):
    """Publisher and subscriber of a robot's command topic, for its guard; ``package`` has the type ``LowCmd``.

    Raises ``MessageError`` when the type is not built.
    """

    def __init__(self, domain: int, package: str, topic: str) -> None:
        command = interface(package, "msg", "LowCmd")
        super().__init__(domain, "poise_guard", guard=True)
        self._reader = self._node.create_subscription(command, topic, ignore, SENSOR, raw=True)
        self._writer = self._node.create_publisher(command, topic, QoSProfile(depth=1))

    def take(self) -> list[bytes]:
        """Serialised commands since the last call, oldest first, including those of this link."""
        return take_all(self._reader)

    def send(self, data: bytes) -> None:
        """Publish a serialised command."""
        self._writer.publish(data)
