"""Converts the commands forward, stop and spin to velocities, and offers a service that adds two integers."""

import rclpy
from example_interfaces.srv import AddTwoInts
from geometry_msgs.msg import Twist
from rclpy.node import Node
from std_msgs.msg import String

VELOCITIES = {"forward": (0.3, 0.0), "stop": (0.0, 0.0), "spin": (0.0, 0.5)}  # [m/s], [rad/s]


class TextCommander(Node):
    def __init__(self):
        super().__init__("text_commander")
        self.velocity = None
        self.create_subscription(String, "text", self.on_text, 10)
        self.create_service(AddTwoInts, "add_two_ints", self.on_add)
        self.publisher = self.create_publisher(Twist, "cmd_vel", 10)
        self.create_timer(0.1, self.repeat)

    def on_text(self, message):
        self.velocity = VELOCITIES.get(message.data, self.velocity)

    def on_add(self, request, response):
        response.sum = request.a + request.b
        return response

    def repeat(self):
        if self.velocity is not None:
            twist = Twist()
            twist.linear.x, twist.angular.z = self.velocity
            self.publisher.publish(twist)


rclpy.init()
rclpy.spin(TextCommander())
