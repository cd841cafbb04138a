"""Logs roll, pitch and yaw of the IMU once per second."""

import math

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Imu


class ImuLogger(Node):
    def __init__(self):
        super().__init__("imu_logger")
        self.create_subscription(Imu, "imu/data", self.on_imu, 10)

    def on_imu(self, message):
        q = message.orientation
        roll = math.atan2(2.0 * (q.w * q.x + q.y * q.z), 1.0 - 2.0 * (q.x**2 + q.y**2))
        pitch = math.asin(max(-1.0, min(1.0, 2.0 * (q.w * q.y - q.z * q.x))))
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))
        text = f"roll {roll:.3f} pitch {pitch:.3f} yaw {yaw:.3f} rad"
        self.get_logger().info(text, throttle_duration_sec=1.0)


rclpy.init()
rclpy.spin(ImuLogger())
