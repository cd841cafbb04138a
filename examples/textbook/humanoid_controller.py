"""Waves on the command 'wave', with the joint names used in courses."""

import rclpy
from builtin_interfaces.msg import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

POSES = [(-0.5, -1.0, 0.2), (-0.5, -1.4, 0.2), (-0.5, -1.0, 0.2), (0.2, -0.2, 0.9)]  # [rad]


class HumanoidController(Node):
    def __init__(self):
        super().__init__("humanoid_controller")
        self.joints = {}
        self.create_subscription(String, "humanoid_commands", self.on_command, 10)
        self.create_subscription(JointState, "joint_states", self.on_joint_states, 10)
        self.publisher = self.create_publisher(JointTrajectory, "joint_trajectory_controller/joint_trajectory", 10)

    def on_joint_states(self, message):
        self.joints = dict(zip(message.name, message.position))

    def on_command(self, message):
        if message.data != "wave":
            return
        wave = JointTrajectory(joint_names=["right_shoulder_pitch", "right_shoulder_roll", "right_elbow"])
        for k, pose in enumerate(POSES):
            wave.points.append(JointTrajectoryPoint(positions=pose, time_from_start=Duration(sec=2 * (k + 1))))
        self.publisher.publish(wave)
        self.get_logger().info(f"waving with {len(self.joints)} joints")


rclpy.init()
rclpy.spin(HumanoidController())
