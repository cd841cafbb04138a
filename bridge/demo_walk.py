"""The walking part of the demonstration: a square of goals, a wave and a push meanwhile, a stop."""

from __future__ import annotations

import math

from geometry_msgs.msg import PoseStamped
from std_msgs.msg import Float64, String

from bridge.demo_stage import Stage
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.qos import EVENT, SENSOR
from models.types import Mode
from planners.gait.footsteps import Foothold
from planners.nodes.footstep_messages import pose_message

CORNERS = ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0))
"""Corners of the square in the order in which they are walked to, in sides."""

PUSH_SIDE = 2
"""Side of the square on which it is pushed."""

WALK, WAVE, PUSH, STOP = "walk", "walking wave", "walking push", "stop"
"""First words of the events that the report looks for."""


class SquareWalk:
    """Walks a square on ``goal_pose``.

    Args:
        stage: The running graph.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        node = stage.graph.node
        self._goals = node.create_publisher(PoseStamped, topics.GOAL_POSE, EVENT)
        self._words: list[str] = []
        self._walking = False
        self._playing = False
        self._waved = ""
        node.create_subscription(String, topics.GAIT_ROUTE, self._on_route, EVENT)
        for topic in (topics.MOTION_STATE, topics.MOTION_PLAN_STATE):
            node.create_subscription(String, topic, self._on_motion, EVENT)
        self._margin = node.create_subscription(Float64, topics.GAIT_CAPTURE_MARGIN, self._on_margin, SENSOR)

    def play(self) -> None:
        """Walk it and stand.

        Raises:
            PoiseError: A goal is refused or not reached, or the robot gives up.
        """
        stage, config = self._stage, self._stage.config
        start = Foothold(*stage.observer.place)
        stage.note(f"{WALK} a square of {config.square_side:g} m")
        stage.graph.send("walk")
        self._playing = True
        stage.watch(lambda: self._walking, config.start_limit, "it does not begin to walk")
        stage.graph.node.destroy_subscription(self._margin)  # 50 of them a second would only delay the other messages
        stage.graph.send("wave")
        for side, (along, left) in enumerate(CORNERS):
            corner = start.moved(config.square_side * along, config.square_side * left)
            self._go(side, Foothold(*corner, start.yaw + 0.5 * math.pi * (side + 1)))
        stage.watch(lambda: self._waved == topics.MOTION_DONE, config.motion_limit, "the wave did not end")
        stage.note(STOP)
        stage.graph.send("stop")
        stage.watch(lambda: stage.graph.mode == Mode.STAND.value, config.walk_limit, "it does not stop")
        stage.pause(config.recover_time)

    def _go(self, side: int, goal: Foothold) -> None:
        """One side of the square and the turn at its end."""
        stage, config = self._stage, self._stage.config
        self._words.clear()
        stage.note(f"side {side + 1}")
        self._goals.publish(pose_message(goal, topics.ODOM_FRAME))
        stage.watch(lambda: bool(self._words), config.pause + 5.0, "no answer to a goal")
        if side == PUSH_SIDE:
            stage.pause(config.walk_push_after)
            force = config.walk_push * stage.model.mass / config.push_duration
            stage.push(stage.forward(force), PUSH)
        running = topics.ROUTE_RUNNING
        stage.watch(
            lambda: not self._words[-1].startswith(running), config.walk_limit, f"corner {side + 1} not reached"
        )
        if self._words[-1] != topics.ROUTE_DONE:
            raise PoiseError(f"corner {side + 1}: {self._words[-1]}")

    def _on_motion(self, message: String) -> None:
        """The wave begins when its plan is there, which takes a busy machine some seconds."""
        if not self._playing:
            return
        self._waved = message.data.partition(":")[0]
        if self._waved == topics.MOTION_RUNNING:
            self._stage.note(WAVE)
        elif self._waved == topics.MOTION_DONE:
            self._stage.events.append((self._stage.observer.stamp, f"{WAVE} {topics.MOTION_DONE}"))
        else:
            raise PoiseError(f"{WAVE}: {message.data}")

    def _on_route(self, message: String) -> None:
        self._words.append(message.data)

    def _on_margin(self, message: Float64) -> None:
        """The gait planner tells its margin from when it has taken over the robot."""
        self._walking = True
