"""Walks up stairs of known geometry by footsteps with heights: `poise up --terrain flight`, then this program.

The argument is the number of steps up after which it ends; without one it also walks down. Heights of footsteps are
those of the soles in `odom` when the message is sent: `base_footprint` is midway between the soles, at their height.
"""

import sys
from itertools import takewhile

import pinocchio as pin
import rclpy
from nav_msgs.msg import Path
from rclpy.node import Node
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from models.heading import heading
from models.robot_model import RobotModel
from models.terrain import terrain_named
from planners.gait.footsteps import Foothold
from planners.gait.scaling import load_gait_config
from planners.nodes.footstep_messages import path_from_steps
from planners.terrain.stairs import Stairs, stair_footsteps

ROBOT, FLIGHT = RobotModel.load("g1"), terrain_named("flight")
ENDS = ("done", "ended", "refused")  # first words on `gait/route` when footsteps have ended


class StairClimber(Node):
    def __init__(self):
        super().__init__("stair_climber")
        self.poses, self.report = {}, ""
        self.create_subscription(TFMessage, "/tf", self.on_transforms, 10)
        self.create_subscription(String, "gait/route", self.on_report, 10)
        self.footsteps = self.create_publisher(Path, "gait/footsteps_command", 10)
        self.walk = self.create_client(Trigger, "mode/walk")
        self.walks = False
        self.create_subscription(Float64, "gait/capture_margin", self.on_margin, 10)

    def on_transforms(self, message):
        for each in message.transforms:
            p, q = each.transform.translation, each.transform.rotation
            self.poses[each.child_frame_id] = pin.XYZQUATToSE3([p.x, p.y, p.z, q.x, q.y, q.z, q.w])

    def on_margin(self, message):
        self.walks = True  # the gait accepts footsteps

    def on_report(self, message):
        self.report = message.data
        self.get_logger().info(message.data)

    def wait(self, condition):
        while not condition():
            rclpy.spin_once(self, timeout_sec=0.1)

    def here(self):
        """Middle between the soles in `odom`."""
        self.wait(lambda: {"base_link", "base_footprint"} <= self.poses.keys())
        x, y, z, *turn = pin.SE3ToXYZQUAT(self.poses["base_link"] * self.poses["base_footprint"]).tolist()
        return Foothold(x, y, heading(*turn), z)

    def climb(self, up):
        self.walk.wait_for_service()
        answer = self.walk.call_async(Trigger.Request())
        self.wait(answer.done)
        self.get_logger().info(answer.result().message)
        if not answer.result().success:
            return False
        self.wait(lambda: self.walks and self.footsteps.get_subscription_count() > 0)
        here = self.here()
        # the robot faces the stairs at the start of the simulation, where x of `odom` is zero
        stairs = Stairs(FLIGHT.patch - here.x, FLIGHT.height, FLIGHT.size, FLIGHT.count, FLIGHT.landing, 6.0)
        steps = stair_footsteps(stairs, here, ROBOT, load_gait_config(ROBOT), stride=0.25, together=True)
        if up:
            steps = list(takewhile(lambda step: step.hold.z < here.z + (up + 0.5) * FLIGHT.height, steps))
        self.footsteps.publish(path_from_steps(0, steps))
        self.wait(lambda: self.report.startswith(ENDS))
        return self.report == "done"


rclpy.init()
climber = StairClimber()
sys.exit(not climber.climb(int(sys.argv[1]) if sys.argv[1:] else 0))
