"""The supervisor of a graph of a few fake topics."""

from functools import partial
from typing import Any

from geometry_msgs.msg import Twist
from msgspec.structs import replace
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from rclpy.time import Time
from std_msgs.msg import Float64, Header, String
from std_srvs.srv import Trigger

from models.nodes import topics
from models.nodes.qos import COMMAND, EVENT, LATCHED, STATE
from models.status import GaitStatus, MotionState, MotionStatus, SupervisorStatus
from models.types import Mode
from tests.ros.conftest import StatusTopic


class FakeSupervisor(Node):
    """Waves on command, refuses the rest, and reports that."""

    def __init__(self, context: Context) -> None:
        super().__init__("supervisor", context=context)
        self.refused = self.answered = 0
        self.texts: list[str] = []
        self.create_subscription(String, topics.HUMANOID_COMMANDS, self.on_text, EVENT)
        self.states = StatusTopic(self, topics.MOTION_STATUS)
        self.status = StatusTopic(self, topics.SUPERVISOR_STATUS, LATCHED)
        self.gait = StatusTopic(self, topics.GAIT_STATUS, LATCHED)
        self.restraints: tuple[str, ...] = ()  #: ``limited``, ``blocked`` and ``unmapped`` of the gait
        self.mode = self.create_publisher(String, topics.MODE, LATCHED)
        self.mode.publish(String(data="stand"))
        self.create_service(Trigger, "mode/damp", self.on_damp)
        for mode in ("walk", "stand"):
            self.create_service(Trigger, f"mode/{mode}", partial(self.on_mode, mode))
        self.create_subscription(Twist, topics.CMD_VEL, lambda message: None, COMMAND)
        self.odometry, self.speed, self.silent = self.create_publisher(Odometry, topics.ODOM, STATE), 1.0, False
        self.velocity, self.asked = self.create_publisher(Twist, topics.GAIT_VELOCITY, COMMAND), Twist()
        self.commander = self.create_publisher(String, topics.COMMANDER, LATCHED)
        self.factor = self.create_publisher(Float64, topics.REAL_TIME_FACTOR, LATCHED)
        self.record = SupervisorStatus("g1", Mode.STAND, 0, "a velocity of another program", (), holds=("held",))
        self.create_timer(0.05, self.report)

    def on_text(self, message: String) -> None:
        self.texts.append(message.data)
        self.answered += 1
        if message.data == "wave":
            self.states.publish(MotionStatus(MotionState.RUNNING))
        elif message.data == "fly":
            self.refused += 1
        elif message.data == "stop":
            self.states.publish(MotionStatus(MotionState.ENDED, "", "stopped"))
        elif message.data.startswith("forward"):
            self.mode.publish(String(data="walk"))
            self.gait.publish(GaitStatus(True, False, "forward 9 limited to 1.2" if "9" in message.data else ""))

    def on_damp(self, request: Any, response: Any) -> Any:
        response.success, response.message = False, "the robot would drop"
        return response

    def on_mode(self, mode: str, request: Any, response: Any) -> Any:
        self.mode.publish(String(data=mode))
        if mode == "walk":
            self.gait.publish(GaitStatus(True, False, *self.restraints))
        response.success, response.message = True, mode
        return response

    def report(self) -> None:
        stamp = Time(nanoseconds=int(self.speed * self.get_clock().now().nanoseconds))
        if not self.silent:
            self.odometry.publish(Odometry(header=Header(stamp=stamp.to_msg())))
        self.velocity.publish(self.asked)
        answer = "unknown command 'fly'" if self.texts[-1:] == ["fly"] else f"done: {self.texts[-1:]}"
        self.status.publish(replace(self.record, refused=self.refused, answered=self.answered, answer=answer))
