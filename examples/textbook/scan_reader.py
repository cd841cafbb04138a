"""Walks at 0.3 m/s; turns at 0.5 rad/s when the scan shows an obstacle within 1 m ahead."""

import math

import rclpy
from geometry_msgs.msg import Twist
from rclpy.node import Node
from sensor_msgs.msg import LaserScan

AHEAD = 0.7  # half of the evaluated sector [rad]


class ScanReader(Node):
    def __init__(self):
        super().__init__("scan_reader")
        self.create_subscription(LaserScan, "scan", self.on_scan, 10)
        self.publisher = self.create_publisher(Twist, "cmd_vel", 10)

    def on_scan(self, scan):
        velocity = Twist()
        if any(r < 1.0 and self.ahead(scan, i) for i, r in enumerate(scan.ranges)):
            velocity.angular.z = 0.5
        else:
            velocity.linear.x = 0.3
        self.publisher.publish(velocity)

    def ahead(self, scan, i):
        angle = scan.angle_min + i * scan.angle_increment
        return abs(math.remainder(angle, math.tau)) < AHEAD


rclpy.init()
rclpy.spin(ScanReader())
