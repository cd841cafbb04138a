"""Publishes a synthetic laser scan in the frame laser_frame at 10 Hz."""

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import LaserScan


class FakeScan(Node):
    def __init__(self):
        super().__init__("fake_scan")
        self.publisher = self.create_publisher(LaserScan, "scan", 10)
        self.create_timer(0.1, self.publish)

    def publish(self):
        scan = LaserScan(angle_min=-1.57, angle_max=1.57, angle_increment=3.14 / 180, range_min=0.1, range_max=10.0)
        scan.header.frame_id = "laser_frame"
        scan.header.stamp = self.get_clock().now().to_msg()
        scan.ranges = [5.0] * 181
        self.publisher.publish(scan)


rclpy.init()
rclpy.spin(FakeScan())
