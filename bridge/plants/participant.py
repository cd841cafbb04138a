"""A participant in a robot's DDS domain that is polled: a node without an executor, without parameters and logs."""

from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

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


def take(subscription: Any) -> Any:
    """Next message of a subscription, serialised where it is raw; None without one."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return None if taken is None else taken[0]


def ignore(message: Any) -> None:
    """Callback of polled subscriptions; never called."""
