"""Latency floor: four sensor messages per tick, answered by a joint command with the same stamp, without decoding."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import get_context
from queue import Empty
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import Imu, JointState
from trajectory_msgs.msg import JointTrajectory

from bridge.driver.probes import LatencyProbe
from bridge.driver.run_loop import Pacer
from bridge.launch.parameters import REALTIME
from bridge.ros.environment import graph_environment, join_graph
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS, STAMP_OFFSET, STAMP_SIZE, stamp_of
from models.nodes.messages import ImuCodec, JointCommandCodec, JointStateCodec, WrenchCodec
from models.nodes.qos import COMMAND, SENSOR
from models.nodes.realtime import die_with_parent, settle, use_fifo
from models.nodes.spin import Stop, make_executor, spin
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import JointCommand

if TYPE_CHECKING:
    from multiprocessing.queues import Queue

NAMESPACE = "pingpong"
PERIOD = 0.001  # default period, equal to the tick of the graph [s]
START_TIMEOUT = 30.0  # maximum wait for the echo [s]


def _sensor_topics() -> list[tuple[type, str]]:
    feet = [(WrenchStamped, topic) for topic in topics.FOOT_WRENCHES]
    return [(Imu, topics.IMU_RAW), *feet, (JointState, topics.JOINT_STATES)]


def echo(robot: str, priority: int) -> None:
    """Answer until SIGTERM, with the scheduling of the graph."""
    die_with_parent()
    model = RobotModel.load(robot)
    zero = np.zeros(model.nj)
    answer = bytearray(JointCommandCodec(model).encode(0, JointCommand(zero, zero, zero)))
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    stop = Stop()
    node = rclpy.create_node("echo", namespace=NAMESPACE)
    publisher = node.create_publisher(JointTrajectory, topics.JOINT_SETPOINTS, COMMAND)
    stamp = slice(STAMP_OFFSET, STAMP_OFFSET + STAMP_SIZE)

    def on_joints(data: bytes) -> None:
        answer[stamp] = data[stamp]
        publisher.publish(bytes(answer))

    for kind, topic in _sensor_topics():
        callback = on_joints if kind is JointState else lambda data: None
        node.create_subscription(kind, topic, callback, SENSOR, raw=True)
    executor = make_executor()
    executor.add_node(node)
    settle()
    use_fifo(priority, _ignore)
    spin(executor, [node], stop)
    executor.remove_node(node)
    node.destroy_node()
    try_shutdown()


def measure(robot: str, duration: float, domain_id: int, period: float = PERIOD) -> LatencyProbe:
    """Run the ping-pong for ``duration`` [s], with the scheduling of the graph; ``PoiseError`` if it fails."""
    context = get_context("spawn")
    answer: Queue[LatencyProbe | str] = context.Queue()
    process = context.Process(target=_measure, args=(robot, duration, domain_id, period, answer))
    process.start()
    try:
        result = answer.get(timeout=duration + 2.0 * START_TIMEOUT)
    except Empty as error:
        process.terminate()
        raise PoiseError("the ping-pong did not end in time") from error
    finally:
        process.join()
    if isinstance(result, str):
        raise PoiseError(result)
    return result


def _measure(robot: str, duration: float, domain_id: int, period: float, answer: Queue[LatencyProbe | str]) -> None:
    die_with_parent()
    try:
        answer.put(_ping_echo(robot, duration, domain_id, period))
    except PoiseError as error:
        answer.put(str(error))


def _ping_echo(robot: str, duration: float, domain_id: int, period: float) -> LatencyProbe:
    join_graph(domain_id=domain_id)
    priority = int(str(REALTIME["realtime.priority"]))
    command = [sys.executable, "-m", "benchmarks.graph.pingpong", robot, str(priority)]
    child = subprocess.Popen(
        command, env={**os.environ, **graph_environment(domain_id=domain_id)}, stdin=subprocess.DEVNULL
    )
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("ping", namespace=NAMESPACE)
    executor = make_executor()
    executor.add_node(node)
    try:
        return _ping(node, executor, RobotModel.load(robot), round(duration / period), period, priority)
    finally:
        child.terminate()
        child.wait()
        executor.remove_node(node)
        node.destroy_node()
        try_shutdown()


def _ignore(text: str) -> None:
    """Discard a log line that the graph's processes already write."""


def _ping(node: Any, executor: Any, model: RobotModel, ticks: int, tick_length: float, priority: int) -> LatencyProbe:
    probe = LatencyProbe()
    publish = _publishers(node, model)
    period = round(tick_length * NANOSECONDS)
    answers = node.create_subscription(
        JointTrajectory,
        topics.JOINT_SETPOINTS,
        lambda data: probe.receive(stamp_of(data) // period),
        COMMAND,
        raw=True,
    )
    end = time.monotonic() + START_TIMEOUT
    while answers.get_publisher_count() == 0 or not publish(-1):
        executor.spin_once(timeout_sec=0.1)
        if time.monotonic() > end:
            raise PoiseError(f"the echo does not answer within {START_TIMEOUT:.0f} s")
    settle()
    use_fifo(priority, _ignore)
    pacer = Pacer(tick_length, sleep=lambda seconds: executor.spin_once(timeout_sec=seconds))
    late = 0.0
    for tick in range(ticks):
        probe.publish(tick, late, True)
        publish(tick * period)
        executor.spin_once(timeout_sec=0.0)
        late = pacer.wait()
    return probe


def _publishers(node: Any, model: RobotModel) -> Callable[[int], bool]:
    """Return a function that publishes a tick with a stamp [ns]; negative: only whether all subscribers match."""
    publishers = [node.create_publisher(kind, topic, SENSOR) for kind, topic in _sensor_topics()]
    imu, feet = ImuCodec(topics.IMU_FRAME), [WrenchCodec(frame) for frame in SOLE_FRAMES]
    joints = JointStateCodec(model)
    vector, wrench, zero = np.zeros(3), np.zeros(6), np.zeros(model.nj)

    def publish(stamp: int) -> bool:
        if stamp >= 0:
            publishers[0].publish(imu.encode(stamp, vector, vector))
            publishers[1].publish(feet[0].encode(stamp, wrench))
            publishers[2].publish(feet[1].encode(stamp, wrench))
            publishers[3].publish(joints.encode(stamp, zero, zero, zero))
            return True
        return all(publisher.get_subscription_count() > 0 for publisher in publishers)

    return publish


if __name__ == "__main__":
    echo(sys.argv[1], int(sys.argv[2]))
