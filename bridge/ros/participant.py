"""Short-lived participants of a graph, and subscriptions that are polled."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from bridge.ros.environment import join_graph, roomy_profile
from bridge.ros.processes import absolute_namespace, in_namespace
from models.nodes.spin import log_arguments


@contextmanager
def participant(
    name: str,
    *,
    network: bool = False,
    namespace: str = "",
    receive_buffer: int = 0,
    make: Callable[..., Any] = SingleThreadedExecutor,
) -> Iterator[tuple[Node, Any]]:
    """A node in a ROS context of its own, and its executor, until the end of the ``with`` block.

    With ``network`` the robot may run on another machine. ``receive_buffer`` is requested for each socket [bytes]; 0:
    the default. ``make`` makes the executor. Raises ``PoiseError`` for an invalid namespace.
    """
    namespace = absolute_namespace(namespace)
    join_graph(network=network)
    context = Context()
    with roomy_profile(receive_buffer) if receive_buffer else nullcontext():
        arguments = [*sys.argv, *log_arguments()]
        rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = Node(name, context=context, **in_namespace(namespace))
    executor = make(context=context)
    executor.add_node(node)
    try:
        yield node, executor
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_node()
        try_shutdown(context=context)


def ignore(message: Any) -> None:
    """Callback of polled subscriptions; never called."""


def newest(subscription: Any) -> bytes | None:
    """Newest serialised message of a raw subscription of depth 1, or None; those between two polls cost nothing."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return None if taken is None else bytes(taken[0])
