"""A participant in a robot's DDS domain that is polled: a node without an executor, without parameters and logs."""

from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from models.nodes.interfaces import interface
from models.nodes.spin import log_arguments

QUEUE = 32  #: Messages kept between two ticks
SENSOR = QoSProfile(depth=QUEUE, reliability=ReliabilityPolicy.BEST_EFFORT)


def join(domain: int, name: str) -> tuple[Context, Node]:
    """A context in a DDS domain and a silent node in it: without parameters, logs and services."""
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
    """Serialised messages of a raw subscription since the last call, the oldest first, at most ``QUEUE``."""
    found: list[bytes] = []
    while len(found) < QUEUE and (data := take(subscription)) is not None:
        found.append(bytes(data))
    return found


def take_stamped(subscription: Any) -> list[tuple[bytes, int, int]]:
    """As ``take_all``, each message with the time at which it was published [ns] and its number by its publisher."""
    found: list[tuple[bytes, int, int]] = []
    with subscription.handle:
        while len(found) < QUEUE and (taken := subscription.handle.take_message(subscription.msg_type, True)):
            data, info = taken
            found.append((bytes(data), info["source_timestamp"], info["publication_sequence_number"] or 0))
    return found


def take(subscription: Any) -> Any:
    """Next message of a subscription, serialised where it is raw; None without one."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return None if taken is None else taken[0]


def reachable(node: Node, requests: Any, responses: str) -> bool:
    """Whether both topics of a service over messages are matched; a request before that has no answer.

    ``requests`` is the publisher, ``responses`` the name of the topic of the answers.
    """
    return bool(requests.get_subscription_count() and node.count_publishers(responses))


def ignore(message: Any) -> None:
    """Callback of polled subscriptions; never called."""


class CommandLink:
    """Both ends of the topic of a robot's commands, for its guard; ``MessageError`` when the type is not built.

    ``package`` has the type ``LowCmd``.
    """

    def __init__(self, domain: int, package: str, topic: str) -> None:
        command = interface(package, "msg", "LowCmd")
        self._context, self._node = join(domain, "poise_guard")
        self._reader = self._node.create_subscription(command, topic, ignore, SENSOR, raw=True)
        self._writer = self._node.create_publisher(command, topic, QoSProfile(depth=1))

    def take(self) -> list[bytes]:
        """Serialised commands since the last call, the oldest first, those of this link included."""
        return take_all(self._reader)

    def send(self, data: bytes) -> None:
        """Publish a serialised command."""
        self._writer.publish(data)

    def close(self) -> None:
        """Leave the robot's domain."""
        self._node.destroy_node()
        try_shutdown(context=self._context)
