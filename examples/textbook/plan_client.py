"""Requests a plan that moves the left hand to a position, and its execution."""

import rclpy
from poise_interfaces.srv import PlanMotion
from rclpy.node import Node


class PlanClient(Node):
    def __init__(self):
        super().__init__("plan_client")
        self.client = self.create_client(PlanMotion, "plan_motion")
        self.client.wait_for_service()

    def plan(self, x, y, z):
        request = PlanMotion.Request(frame="left_hand", execute=True)
        request.target.header.frame_id = "base_footprint"
        place = request.target.pose.position
        place.x, place.y, place.z = x, y, z
        future = self.client.call_async(request)
        rclpy.spin_until_future_complete(self, future)
        return future.result()


rclpy.init()
client = PlanClient()
answer = client.plan(0.25, 0.25, 0.85)
client.get_logger().info(f"{'accepted' if answer.success else 'refused'}: {answer.message}")
