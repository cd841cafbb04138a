"""Moves the left elbow along a sine with single points at 50 Hz."""

import math

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

PERIOD = 0.02  # [s]


class ArmCommands(Node):
    def __init__(self):
        super().__init__("arm_commands")
        self.start, self.time = None, 0.0
        self.create_subscription(JointState, "joint_states", self.on_joint_states, 10)
        self.publisher = self.create_publisher(JointTrajectory, "joint_trajectory_controller/joint_trajectory", 10)
        self.create_timer(PERIOD, self.publish)

    def on_joint_states(self, message):
        if self.start is None:
            self.start = next(p for n, p in zip(message.name, message.position) if n.startswith("left_elbow"))

    def publish(self):
        if self.start is None:
            return
        self.time += PERIOD
        point = JointTrajectoryPoint(positions=[self.start - 0.3 * (1.0 - math.cos(self.time))])
        point.time_from_start.nanosec = int(1e9 * PERIOD)
        self.publisher.publish(JointTrajectory(joint_names=["left_elbow"], points=[point]))


rclpy.init()
rclpy.spin(ArmCommands())
