"""Walks at 0.3 m/s; turns at 0.5 rad/s where the scan sees something within a metre."""

import math

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from sensor_msgs.msg import LaserScan


class ScanReader(Node):
    def __init__(self):
        super().__init__("scan_reader")
        self.create_subscription(LaserScan, "scan", self.on_scan, 10)
        self.publisher = self.create_publisher(Twist, "cmd_vel", 10)

    def on_scan(self, scan):
        nearest = min((r for r in scan.ranges if math.isfinite(r)), default=math.inf)
        velocity = Twist()
        if nearest < 1.0:
            velocity.angular.z = 0.5
        else:
            velocity.linear.x = 0.3
        self.publisher.publish(velocity)


rclpy.init()
rclpy.spin(ScanReader())
