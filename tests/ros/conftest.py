"""Nodes under test in this process, beside a node that plays the rest of the graph."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from bridge.ros.environment import join_graph


class Bench:
    """Executor with nodes under test and ``world``, which plays everybody else.

    Args:
        context: ROS context of its own.
    """

    def __init__(self, context: Context) -> None:
        self.context = context
        self.world = Node("world", context=context)
        self._nodes: list[Any] = []
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.world)

    def add(self, kind: Callable[..., Any], *, active: bool = True, **parameters: object) -> Any:
        """Create a node, configured, and activated unless told otherwise."""
        arguments = ["--ros-args"]
        for name, value in parameters.items():
            arguments += ["-p", f"{name}:={value}"]
        node = kind(context=self.context, cli_args=arguments)
        self._nodes.append(node)
        self._executor.add_node(node)
        node.trigger_configure()
        if active:
            node.trigger_activate()
        return node

    def remove(self, node: Any) -> None:
        """Destroy a node under test."""
        self._nodes.remove(node)
        self._executor.remove_node(node)
        node.destroy_node()

    def spin(self, duration: float) -> None:
        """Serve callbacks for a time [s]."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.01)

    def wait(self, condition: Callable[[], object], timeout: float = 10.0) -> None:
        """Serve callbacks until a condition holds."""
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, "it did not happen in time"
            self._executor.spin_once(timeout_sec=0.01)

    def close(self) -> None:
        """Destroy every node."""
        for node in list(self._nodes):
            self.remove(node)
        self._executor.remove_node(self.world)
        self.world.destroy_node()
        self._executor.shutdown()


@pytest.fixture
def bench(ros_domain_id: int) -> Iterator[Bench]:
    """A bench in a ROS domain of its own, on loopback."""
    join_graph()
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    made = Bench(context)
    yield made
    made.close()
    context.try_shutdown()
