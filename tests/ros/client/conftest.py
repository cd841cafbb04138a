"""A graph of a few fake topics, served by a thread."""

import threading
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from bridge.ros.environment import join_graph
from tests.ros.client.fake_supervisor import FakeSupervisor


@pytest.fixture
def context(ros_domain_id: int) -> Iterator[Context]:
    join_graph()
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    yield context
    context.try_shutdown()


@pytest.fixture
def supervisor(context: Context) -> Iterator[FakeSupervisor]:
    executor = SingleThreadedExecutor(context=context)
    node = FakeSupervisor(context)
    executor.add_node(node)
    stop = threading.Event()

    def serve() -> None:
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.02)

    thread = threading.Thread(target=serve)
    thread.start()
    yield node
    stop.set()
    thread.join()
    executor.remove_node(node)
    node.destroy_node()
