"""A world of a few topics beside the supervisor under test."""

from typing import Any

import numpy as np
from msgspec.structs import replace
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.nodes.supervisor import SupervisorNode
from models.nodes import topics
from models.nodes.messages import JointStateCodec, set_stamp
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import LATCHED, SENSOR
from models.robot_model import RobotModel
from tests.support import standing


class World:
    """Drivers that say what they do, and a subscription to the mode."""

    def __init__(self, bench: Any) -> None:
        self.bench = bench
        self.modes: list[str] = []
        self.roll, self.tick, self.silent, self.lag, self.speed = 0.0, 0.0, False, 0, 1.0
        self.twist = np.zeros(6)
        node = bench.world
        node.create_subscription(String, topics.MODE, lambda message: self.modes.append(message.data), LATCHED)
        self._drivers = node.create_publisher(String, topics.DRIVER_STATE, LATCHED)
        self._clients: dict[str, Any] = {}

    def robot(self, g1: RobotModel) -> None:
        """Publish what an upright robot publishes, a hundred times a second; ``roll`` lays it down.

        ``silent`` leaves out all but the clock, as for one who has not found the other topics yet; ``lag`` [ns] makes
        their stamps old. The time of the robot runs at ``speed``.
        """
        node, joints, odom = self.bench.world, JointStateCodec(g1), OdometryCodec()
        description = node.create_publisher(String, topics.ROBOT_DESCRIPTION, LATCHED)
        description.publish(String(data=g1.urdf.read_text(encoding="utf-8")))
        topic = node.create_publisher(JointState, topics.JOINT_STATES, SENSOR)
        odometry = node.create_publisher(Odometry, topics.ODOM, SENSOR)
        command = node.create_publisher(JointState, topics.POSTURE, SENSOR)
        clock = node.create_publisher(Clock, topics.CLOCK, SENSOR)
        q, zero = g1.standing_configuration(), np.zeros(g1.nj)

        def publish() -> None:
            self.tick += self.speed
            stamp = round(10_000_000 * self.tick)
            q[3:7] = np.sin(0.5 * self.roll), 0.0, 0.0, np.cos(0.5 * self.roll)
            time = Clock()
            set_stamp(time.clock, stamp)
            clock.publish(time)
            if self.silent:
                return
            odometry.publish(odom.encode(stamp - self.lag, replace(standing(g1, q=q), v=np.append(self.twist, zero))))
            for publisher in (topic, command):
                publisher.publish(joints.encode(stamp - self.lag, q[7:], zero, zero))

        self._timer = node.create_timer(0.01, publish)

    def drivers(self, state: str) -> None:
        """Publish a driver state."""
        self._drivers.publish(String(data=state))

    def adopted(self, g1: RobotModel, **parameters: object) -> Any:
        """The supervisor of a robot that stands."""
        self.robot(g1)
        self.drivers(topics.ACTIVE)
        node = self.bench.add(SupervisorNode, **parameters)
        self.bench.wait(lambda: self.modes and node._reports.complete)
        self.bench.spin(0.2)
        return node

    def call(self, service: str) -> tuple[bool, str]:
        """Call a Trigger service."""
        if service not in self._clients:
            self._clients[service] = self.bench.world.create_client(Trigger, service)
            self.bench.wait(self._clients[service].service_is_ready)
            self.bench.spin(0.2)
        future = self._clients[service].call_async(Trigger.Request())
        self.bench.wait(future.done)
        return future.result().success, future.result().message
