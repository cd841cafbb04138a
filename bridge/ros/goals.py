"""Access of the actions to the robot: status topics, services, and one goal at a time."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from nav_msgs.msg import Odometry
from pydantic import Field
from pydantic.dataclasses import dataclass as config_dataclass
from rclpy.callback_groups import CallbackGroup
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String

from bridge.ros.client import next_step
from models.config import STRICT, Positive
from models.errors import CommandError, MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.status import MotionState, MotionStatus, RouteState, RouteStatus, SupervisorStatus
from models.types import CommandReply, Mode, Vector


@config_dataclass(frozen=True, slots=True, config=STRICT)
class ActionsConfig:
    """Timeouts of the actions and the criterion for rest."""

    period: Annotated[float, Field(ge=0.01, le=1.0)]  #: Polling period [s]
    feedback_period: Annotated[float, Field(ge=0.01, le=10.0)]  #: Feedback period [s]
    #: Longest wait for the answer of a service or the gait planner [s]
    answer_timeout: Annotated[float, Field(gt=0.0, le=600.0)]
    #: Longest wait for a motion to start, planning included [s]
    start_timeout: Annotated[float, Field(gt=0.0, le=600.0)]
    #: Longest wait for a stopped motion to come to rest [s]
    halt_timeout: Annotated[float, Field(gt=0.0, le=600.0)]
    walk_timeout: Positive  #: Longest walk to one goal [s]
    #: Longest wait for a standstill after the last footstep [s]
    stand_timeout: Annotated[float, Field(gt=0.0, le=600.0)]
    #: Period at which a goal is published until it is answered [s]
    goal_period: Annotated[float, Field(gt=0.0, le=60.0)]
    words: Annotated[int, Field(ge=10, le=10000)]  #: Number of stored status messages of a topic [1]
    quiet: Annotated[int, Field(ge=1, le=100)]  #: Number of polls without motion from which the robot is at rest [1]
    moved: Annotated[float, Field(gt=0.0, le=0.1)]  #: Joint change between two polls that counts as motion [rad]


MOVING = (Mode.STAND.value, Mode.WALK.value, Mode.MOTION.value)  #: Modes in which an action may continue


class _WhileTrue(CallbackGroup):
    """Callbacks that are called only while a condition holds; the middleware keeps the newest message until then."""

    def __init__(self, condition: Callable[[], bool]) -> None:
        super().__init__()
        self._condition = condition

    def can_execute(self, entity: Any) -> bool:
        return self._condition()

    def beginning_execution(self, entity: Any) -> bool:
        return True

    def ending_execution(self, entity: Any) -> None:
        pass


class RobotClient:
    """Subscriptions and service clients that the actions of one node share.

    The executor of ``node`` must await coroutines. ``motion`` and ``route`` hold the status messages since ``begin``,
    ``stops`` counts requests to end the motion. ``gait_ready`` is set when the gait planner walks; callers clear it.
    Raises ``MessageError`` when the types of the services are not built.
    """

    def __init__(self, node: PoiseNode, config: ActionsConfig) -> None:
        self.config = config
        self.mode = ""
        self.motion: deque[MotionStatus] = deque(maxlen=config.words)
        self.route: deque[RouteStatus] = deque(maxlen=config.words)
        self.stops = 0
        self.gait_ready = False
        self._status: SupervisorStatus | None = None
        self._joints, self._odom = b"", b""
        self._codec, self._odometry = JointStateCodec(node.model), OdometryCodec()
        self._before: Vector | None = None
        self._quiet = self._looks = 0
        self._waiting: list[Future] = []
        self._types = {
            name: interface("poise_interfaces", "srv", kind)
            for name, kind in (("set_mode", "SetMode"), ("command", "Command"))
        }
        self._clients = {name: node.create_client(kind, name) for name, kind in self._types.items()}
        for client in self._clients.values():
            node.own(node.destroy_client, client)
        node.listen(String, topics.MODE, self._on_mode, LATCHED)
        node.listen_status(MotionStatus, topics.MOTION_STATUS, self._on_motion)
        node.listen(String, topics.MOTION_REQUEST, self._on_request, EVENT)
        node.listen_status(RouteStatus, topics.ROUTE_STATUS, self._on_route)
        node.listen_status(SupervisorStatus, topics.SUPERVISOR_STATUS, self._on_status, LATCHED)
        node.listen(Float64, topics.GAIT_CAPTURE_MARGIN, self._on_margin, SENSOR)
        during_goals = _WhileTrue(lambda: bool(self._waiting))  # a thousand messages a second
        node.listen(JointState, topics.POSTURE, self._on_joints, SENSOR, raw=True, group=during_goals)
        node.listen(Odometry, topics.ODOM, self._on_odom, SENSOR, raw=True, group=during_goals)
        node.own(node.destroy_timer, node.every(config.period, self._look))

    @property
    def motions_begun(self) -> int:
        """Number of motions that have begun since ``begin``."""
        return sum(status.state is MotionState.RUNNING for status in self.motion)

    @property
    def routes_begun(self) -> int:
        """Number of routes that have begun since ``begin``."""
        return sum(status.state is RouteState.RUNNING for status in self.route)

    @property
    def feedback_due(self) -> bool:
        """Whether feedback is due at this poll."""
        return self._looks % max(round(self.config.feedback_period / self.config.period), 1) == 0

    def begin(self) -> None:
        """Clear the stored messages; feedback is due."""
        self._looks = 0
        self.motion.clear()
        self.route.clear()
        self.stops = 0

    async def command(self, text: str) -> CommandReply:
        """Send a text command and return the supervisor's reply; ``CommandError`` when it does not answer."""
        return await self._ask("command", text=text)

    async def set_mode(self, mode: Mode) -> CommandReply:
        """Request a mode; ``CommandError`` when the supervisor does not answer."""
        return await self._ask("set_mode", mode=mode.value)

    async def turn(self) -> None:
        """Wait for the next poll."""
        future: Future = Future()
        self._waiting.append(future)
        await future

    async def until(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Wait at most ``timeout`` [s] for a condition; returns whether it was met."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            await self.turn()
        return True

    @property
    def stopped(self) -> str:
        """Why no action can continue, and what to do next; empty otherwise."""
        if self.mode in MOVING:
            return ""
        status = self._status
        known = status is not None and status.mode.value == self.mode
        return self.present_mode + (f"; next: {next_step(status)}" if status is not None and known else "")

    @property
    def present_mode(self) -> str:
        """Present mode with faults and holds as readable text."""
        status = self._status
        reasons = () if status is None or status.mode.value != self.mode else (*status.faults, *status.holds)
        return ": ".join(part for part in (f"mode '{self.mode or 'unknown'}'", "; ".join(reasons)) if part)

    @property
    def posture(self) -> Vector | None:
        """Reference posture of the controller (nj,) [rad]; None before the first, or when it cannot be read."""
        found: Vector | None = self._decoded(self._codec, self._joints)
        return found

    def distance(self, x: float, y: float) -> float:
        """Horizontal distance from the base to a point in ``odom`` [m]; NaN before the first odometry."""
        pose = self._decoded(self._odometry, self._odom)
        return math.nan if pose is None else math.hypot(x - pose[0], y - pose[1])

    def _decoded(self, codec: Any, data: bytes) -> Any:
        try:
            return codec.decode(data)[1] if data else None
        except MessageError:
            return None

    async def _ask(self, service: str, **request: str) -> CommandReply:
        client, longest = self._clients[service], self.config.answer_timeout
        if not await self.until(client.service_is_ready, longest):
            raise CommandError(f"service {service} is not available: start the supervisor, with poise_interfaces built")
        future = client.call_async(self._types[service].Request(**request))
        if not await self.until(future.done, longest):
            raise CommandError(f"service {service} did not answer within {longest:g} s")
        answer = future.result()
        return CommandReply(bool(answer.success), str(answer.message))

    @property
    def at_rest(self) -> bool:
        """Whether the reference posture was constant for the last ``config.quiet`` polls."""
        return self._quiet >= self.config.quiet

    def _look(self) -> None:
        if not self._waiting:
            return
        self._looks += 1
        posture, before = self.posture, self._before
        same = posture is not None and before is not None and float(np.abs(posture - before).max()) < self.config.moved
        self._quiet = self._quiet + 1 if same else 0
        self._before = posture
        waiting, self._waiting = self._waiting, []
        for future in waiting:
            future.set_result(None)

    def _on_mode(self, message: String) -> None:
        self.mode = message.data

    def _on_motion(self, status: MotionStatus) -> None:
        if status.state is not MotionState.REFUSED or not self.motions_begun:  # later refusals are for other clients
            self.motion.append(status)

    def _on_route(self, status: RouteStatus) -> None:
        if status.state is not RouteState.REFUSED or not self.routes_begun:  # later refusals are for other clients
            self.route.append(status)

    def _on_status(self, status: SupervisorStatus) -> None:
        self._status = status

    def _on_margin(self, message: Float64) -> None:
        self.gait_ready = True

    def _on_request(self, message: String) -> None:
        self.stops += message.data == topics.STOP_MOTION

    def _on_joints(self, data: bytes) -> None:
        self._joints = data

    def _on_odom(self, data: bytes) -> None:
        self._odom = data


#: Reasons that end a goal, in addition to those from the robot
REPLACED, DEACTIVATED = "replaced by a newer goal", "the action server was deactivated"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a goal, with the reason in ``message``; ``code`` is the error code for actions that define one."""

    success: bool
    message: str
    cancelled: bool = False
    code: int = 0


class Turn:
    """Permission of one goal, given by number, to move the robot."""

    def __init__(self, turns: Turns, number: int) -> None:
        self._turns, self._number = turns, number

    @property
    def ended(self) -> str:
        """Why the goal cannot continue; empty while it can."""
        if self._turns.newest != self._number:
            return REPLACED
        return DEACTIVATED if self._turns.closed else self._turns.robot.stopped


class Turns:
    """Grants the robot to one goal at a time; ``newest`` is the number of the newest, ``closed`` is set if inactive."""

    def __init__(self, robot: RobotClient) -> None:
        self.robot, self.newest, self.closed = robot, 0, False
        self._taken = False

    async def take(self) -> Turn:
        """End the previous goal, and wait until it has ended."""
        self.newest += 1
        turn = Turn(self, self.newest)
        while self._taken:
            await self.robot.turn()
        self._taken = True
        return turn

    def release(self) -> None:
        """Report that the goal and its effect on the robot have ended."""
        self._taken = False


class Action(ABC):
    """Behaviour of one action; ``kind`` is the action type."""

    def __init__(self, robot: RobotClient, kind: Any) -> None:
        self._robot, self._kind = robot, kind

    def refusal(self, request: Any) -> Outcome | None:
        """Why a goal is refused before execution; None for a valid goal."""
        return None

    @abstractmethod
    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Execute the goal. In any outcome, the robot is at rest or follows another client afterwards."""

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        return self._kind.Result(success=outcome.success, message=outcome.message)


def goal(turns: Turns, action: Action, refused: Callable[[str], object]) -> Callable[[Any], Any]:
    """Action server callback that sets the goal state by the outcome. A ``PoiseError`` aborts the goal with its text.

    ``refused`` is called with the reason when a goal is refused before execution.
    """

    async def execute(handle: Any) -> Any:
        outcome = action.refusal(handle.request)
        if outcome is None:
            turn = await turns.take()
            try:
                ended = turn.ended
                outcome = Outcome(False, ended) if ended else await action.run(handle, turn)
            except PoiseError as error:
                outcome = Outcome(False, str(error))
            finally:
                turns.release()
        else:
            refused(outcome.message)
        if outcome.cancelled:
            handle.canceled()
        elif outcome.success:
            handle.succeed()
        else:
            handle.abort()
        return action.result(outcome)

    return execute
