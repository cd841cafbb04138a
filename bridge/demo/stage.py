"""Steps of ``poise demo`` on a running graph, and its walk along a square."""

import math
import time
from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from pydantic.dataclasses import dataclass
from rich.console import Console
from std_msgs.msg import Float64

from bridge.launch.graph import Graph
from bridge.record.observer import Observer
from models.config import STRICT, Count, Positive
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.qos import EVENT, SENSOR
from models.nodes.status import subscribe_status
from models.robot_model import RobotModel
from models.status import MotionState, MotionStatus, RouteState, RouteStatus
from models.types import Mode
from planners.gait.footsteps import Foothold
from planners.nodes.footstep_messages import pose_message


@dataclass(frozen=True, slots=True, config=STRICT)
class DemoConfig:
    """Steps and pass criteria of the demonstration; see ``bridge/config/demo.yaml``."""

    start_limit: Positive
    stall_limit: Positive
    quiet_time: Positive
    motions: tuple[str, ...]
    motion_limit: Positive
    pause: Positive
    push_force: tuple[float, float, float]
    push_duration: Positive
    recover_time: Positive
    poll_period: Positive
    com_drift_limit: Positive
    foot_limit: Positive
    height_tolerance: Positive
    hand_travel: Positive
    squat_depth: Positive
    push_excursion: Positive
    square_side: Positive
    walk_limit: Positive
    walk_push: float
    walk_push_after: Positive
    closure_limit: Positive
    turn_tolerance: Positive
    drift_limit: Positive
    walk_wave_steps: Count
    walk_hand_travel: Positive


def timed(console: Console) -> Callable[[str], None]:
    """Return a function that prints a line with the time since this call [s]."""
    begin = time.monotonic()
    return lambda text: console.print(f"[dim]{time.monotonic() - begin:6.1f} s[/dim]  {text}", highlight=False)


class Stage:
    """A running graph with its observer; ``say`` gets one line for each step, ``events`` are stamps [s] and texts."""

    def __init__(self, graph: Graph, model: RobotModel, config: DemoConfig, say: Callable[[str], object]) -> None:
        self.graph, self.model, self.config, self.say = graph, model, config, say
        self.observer = Observer(model, graph.node.context)
        self.events: list[tuple[float, str]] = []
        self._push = graph.node.create_publisher(WrenchStamped, topics.PUSH, EVENT)

    def watch(self, condition: Callable[[], bool], timeout: float, otherwise: str) -> None:
        """Observe until a condition is met; ``PoiseError`` after ``timeout`` [s] or a stall, and in 'damp' or 'off'."""
        stamp, advanced = self.observer.stamp, time.monotonic()
        end = stamp + timeout
        while not condition():
            if self.observer.stamp != stamp:
                stamp, advanced = self.observer.stamp, time.monotonic()
            if stamp > end or time.monotonic() - advanced > self.config.stall_limit:
                raise PoiseError(f"{otherwise}: mode '{self.graph.mode}', drivers '{self.graph.driver_state}'")
            if self.graph.mode in (Mode.DAMP.value, Mode.OFF.value):
                raise PoiseError(f"the run ended in mode '{self.graph.mode}'; the log has the reason")
            self.graph.spin(self.config.poll_period)
            self.observer.poll()

    def pause(self, duration: float) -> None:
        """Observe for a time on the clock of the robot [s]."""
        end = self.observer.stamp + duration
        self.watch(lambda: self.observer.stamp >= end, duration + 1.0, "the clock does not advance")

    def note(self, text: str) -> None:
        """Print an event and store it with the recording."""
        self.events.append((self.observer.stamp, text))
        self.say(text)

    def push(self, force: tuple[float, float, float], text: str) -> None:
        """Push the pelvis with a force in W [N] for ``push_duration``."""
        message = WrenchStamped()
        message.header.frame_id = "base_link"
        message.wrench.force.x, message.wrench.force.y, message.wrench.force.z = force
        self.note(f"{text} {np.linalg.norm(force) * self.config.push_duration:.0f} N.s")
        self._push.publish(message)

    def forward(self, strength: float) -> tuple[float, float, float]:
        """Force along the heading of the robot, backward when negative [N]."""
        yaw = self.observer.place[2]
        return strength * math.cos(yaw), strength * math.sin(yaw), 0.0


#: Corners of the square in the order of the walk, in units of the side length
CORNERS = ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0))
PUSH_SIDE = 2  #: Side of the square on which the robot is pushed
#: Events that the report evaluates, by the beginning of their text
WALK, WAVE, PUSH, STOP = "walk", "walking wave", "walking push", "stop"


class Walk:
    """Base class of the walks to goals on ``goal_pose``."""

    def __init__(self, stage: Stage) -> None:
        self._stage, node = stage, stage.graph.node
        self._goals = node.create_publisher(PoseStamped, topics.GOAL_POSE, EVENT)
        self._routes: list[RouteStatus] = []
        self._walking = False
        subscribe_status(node, RouteStatus, topics.ROUTE_STATUS, self._routes.append)
        self._margin = node.create_subscription(Float64, topics.GAIT_CAPTURE_MARGIN, self._on_margin, SENSOR)

    def _begin(self) -> None:
        """Wait until the robot walks, after the command."""
        limit = self._stage.config.start_limit
        self._stage.watch(lambda: self._walking, limit, "the robot does not begin to walk")
        self._stage.graph.node.destroy_subscription(self._margin)  # its 50 Hz would delay the other messages

    def _stop(self) -> None:
        graph, limit = self._stage.graph, self._stage.config.walk_limit
        graph.send("stop")
        self._stage.watch(lambda: graph.mode == Mode.STAND.value, limit, "the robot does not stop")

    def _on_margin(self, message: Float64) -> None:
        """The gait planner publishes its margin once it controls the robot."""
        self._walking = True


class SquareWalk(Walk):
    """Walks a square on ``goal_pose``."""

    def __init__(self, stage: Stage) -> None:
        super().__init__(stage)
        self._playing = False
        self._waved = False
        subscribe_status(stage.graph.node, MotionStatus, topics.MOTION_STATUS, self._on_motion)

    def play(self) -> None:
        """Walk the square and stand; ``PoiseError`` when a goal is refused or not reached, or the robot is damped."""
        stage, config = self._stage, self._stage.config
        start = Foothold(*stage.observer.place)
        stage.note(f"{WALK} a square of {config.square_side:g} m")
        stage.graph.send("walk")
        self._playing = True
        self._begin()
        stage.graph.send("wave")
        for side, (along, left) in enumerate(CORNERS):
            corner = start.moved(config.square_side * along, config.square_side * left)
            self._go(side, Foothold(*corner, start.yaw + 0.5 * math.pi * (side + 1)))
        stage.watch(lambda: self._waved, config.motion_limit, "the wave did not end")
        stage.note(STOP)
        self._stop()
        stage.pause(config.recover_time)

    def _go(self, side: int, goal: Foothold) -> None:
        stage, config = self._stage, self._stage.config
        self._routes.clear()
        stage.note(f"side {side + 1}")
        self._goals.publish(pose_message(goal, topics.ODOM_FRAME))
        stage.watch(lambda: bool(self._routes), config.pause + 5.0, "no answer to a goal")
        if side == PUSH_SIDE:
            stage.pause(config.walk_push_after)
            force = config.walk_push * stage.model.mass / config.push_duration
            stage.push(stage.forward(force), PUSH)
        stage.watch(
            lambda: self._routes[-1].state is not RouteState.RUNNING,
            config.walk_limit,
            f"corner {side + 1} not reached",
        )
        if self._routes[-1].state is not RouteState.DONE:
            raise PoiseError(f"corner {side + 1}: {self._routes[-1]}")

    def _on_motion(self, status: MotionStatus) -> None:
        """Note the start of the wave from its status: planning takes some seconds on a loaded machine."""
        if not self._playing:
            return
        self._waved = status.state is MotionState.DONE
        if status.state is MotionState.RUNNING:
            self._stage.note(WAVE)
        elif self._waved:
            self._stage.events.append((self._stage.observer.stamp, f"{WAVE} done"))
        else:
            raise PoiseError(f"{WAVE}: {status}")
