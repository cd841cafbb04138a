"""What every part of the demonstration needs: to watch the robot while it waits, to note what happens, to push."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import WrenchStamped

from bridge.demo_config import DemoConfig
from bridge.launch import Graph
from bridge.ros.observer import Observer
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.qos import EVENT
from models.robot_model import RobotModel
from models.types import Mode


class Stage:
    """A running graph, observed.

    Args:
        graph: The running graph.
        model: The robot.
        config: What to do.
        say: Takes one line about each step.

    Attributes:
        observer: Records the robot.
        events: Stamp [s] and text of what happened.
    """

    def __init__(self, graph: Graph, model: RobotModel, config: DemoConfig, say: Callable[[str], object]) -> None:
        self.graph, self.model, self.config, self.say = graph, model, config, say
        self.observer = Observer(model)
        self.events: list[tuple[float, str]] = []
        self._push = graph.node.create_publisher(WrenchStamped, topics.PUSH, EVENT)

    def watch(self, condition: Callable[[], bool], timeout: float, otherwise: str) -> None:
        """Observe until a condition holds.

        Raises:
            PoiseError: It does not hold in time [s], which ``otherwise`` says, or the robot has given up.
        """
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                raise PoiseError(f"{otherwise}: mode '{self.graph.mode}', drivers '{self.graph.driver_state}'")
            if self.graph.mode in (Mode.DAMP.value, Mode.OFF.value):
                raise PoiseError(f"the robot gave up: mode '{self.graph.mode}'; the log says why")
            self.graph.spin(self.config.poll_period)
            self.observer.poll()

    def pause(self, duration: float) -> None:
        """Observe for a time [s]."""
        end = time.monotonic() + duration
        self.watch(lambda: time.monotonic() >= end, duration + 1.0, "the clock stands still")

    def note(self, text: str) -> None:
        """Tell what happens, and keep it with the recording."""
        self.events.append((self.observer.stamp, text))
        self.say(text)

    def push(self, force: tuple[float, float, float], text: str) -> None:
        """Push the pelvis with a force in the world [N] for ``push_duration``."""
        message = WrenchStamped()
        message.header.frame_id = "base_link"
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force
        self.note(f"{text} {np.linalg.norm(force) * self.config.push_duration:.0f} N.s")
        self._push.publish(message)

    def forward(self, strength: float) -> tuple[float, float, float]:
        """A force along the robot's heading, backward when negative [N]."""
        yaw = self.observer.place[2]
        return strength * math.cos(yaw), strength * math.sin(yaw), 0.0
