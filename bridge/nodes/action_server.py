"""Node ``action_server``: long motions as ROS 2 actions, based on the topics and services of the graph."""

import re
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import SingleThreadedExecutor
from trajectory_msgs.msg import JointTrajectory

from bridge.ros.goals import Action, ActionsConfig, Outcome, RobotClient, Turn, Turns, goal
from controllers.safety.health import SupervisorConfig
from controllers.safety.supervisor import GAIT_WORDS
from models.config import default_config
from models.errors import CommandError, JointNameError, MessageError, did_you_mean
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.interfaces import interface
from models.nodes.messages import doubles
from models.nodes.parameters import declare_config, describe
from models.nodes.qos import EVENT
from models.nodes.spin import program
from models.robot_model import RobotModel
from models.status import MotionState, RouteState, RouteStatus
from models.types import CommandReply, Mode
from planners.nodes.footstep_messages import goal_from_message

STOP = "stop"


async def track_motion(
    handle: Any, robot: RobotClient, turn: Turn, feedback: Callable[[str], None], *, planned: bool
) -> Outcome:
    """Track a requested motion by its status until it ends; returns the outcome.

    Call ``robot.begin`` before the goal. ``feedback`` is called with ``requested`` or ``running``. ``planned`` selects
    the refusals that count: those with a request (True) or without one (False). A motion that cannot continue, or is
    cancelled, is stopped. Raises ``CommandError`` when the supervisor does not answer.
    """
    timeout = robot.config.start_timeout
    deadline = time.monotonic() + timeout
    while True:
        running = robot.motions_begun
        if running > 1:
            return Outcome(False, "replaced by a motion of another client")
        newest = robot.motion[-1] if robot.motion else None
        if newest is not None and newest.state is MotionState.REFUSED and bool(newest.request) is planned:
            return Outcome(False, ": ".join(part for part in (newest.request, newest.reason) if part))
        if newest is not None and newest.state is MotionState.DONE and running:
            return Outcome(True, "completed")
        ended = newest if newest is not None and newest.state is MotionState.ENDED and running else None
        if ended is not None:
            await robot.turn()  # the mode that ended it, and its reasons, may arrive later
        if why := turn.ended:
            await _halt(robot)
            return Outcome(False, why)
        if ended is not None:
            return Outcome(False, "stopped by another client" if robot.stops else ended.reason)
        if handle.is_cancel_requested:
            stopped = await _halt(robot)
            return Outcome(False, f"cancelled; {stopped}", cancelled=True)
        if not running and time.monotonic() > deadline:
            await _halt(robot)
            return Outcome(False, f"the motion did not start within {timeout:g} s")
        if robot.feedback_due:
            feedback(MotionState.RUNNING.value if running else "requested")
        await robot.turn()


async def _halt(robot: RobotClient) -> str:
    """Stop the robot and wait for the standstill; returns the resulting state as text."""
    if robot.stopped:
        return robot.stopped
    reply = await robot.command(STOP)
    if not reply.accepted:
        return reply.reason
    config = robot.config
    await robot.until(lambda: not robot.at_rest, 2.0 * config.period)  # the stop takes effect with a delay
    over = await robot.until(lambda: robot.at_rest or bool(robot.stopped), config.halt_timeout)
    return "the robot holds its posture" if over else f"the motion has not ended within {config.halt_timeout:g} s"


def _words(text: str) -> list[str]:
    return re.findall(r"\w+", text.lower())


class ExecuteMotion(Action):
    """Plays a motion by name; ``motions`` are the known names, for messages."""

    def __init__(self, robot: RobotClient, kind: Any, motions: Sequence[str]) -> None:
        super().__init__(robot, kind)
        self._motions = tuple(motions)

    def refusal(self, request: Any) -> Outcome | None:
        """Refuse texts with a gait word or ``stop``, which the supervisor would execute."""
        words = _words(request.motion)
        if STOP in words:
            return Outcome(False, f"'{STOP}' is not a motion; cancel the goal, or send '{STOP}' as a command")
        word = next((word for word in words if word in GAIT_WORDS), None)
        return None if word is None else Outcome(False, f"'{word}' is not a motion; walk with walk_to, or a velocity")

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Execute the goal; see ``ExecuteMotion.action``."""
        robot, begin = self._robot, time.monotonic()
        robot.begin()
        text = handle.request.motion
        reply = await robot.command(text)
        if not reply.accepted and self._motions and not set(self._motions).intersection(_words(text)):
            near = did_you_mean(text.strip().lower(), self._motions)
            known = ", ".join(self._motions)
            return Outcome(False, f"unknown command '{text[:32]}'{near or ';'} motions: {known}")
        if not reply.accepted:
            return Outcome(False, reply.reason)

        def feedback(state: str) -> None:
            handle.publish_feedback(self._kind.Feedback(state=state, elapsed=time.monotonic() - begin))

        return await track_motion(handle, robot, turn, feedback, planned=True)


class FollowJointTrajectory(Action):
    """Executes a trajectory of MoveIt with the balance controller, by its topic."""

    def __init__(self, robot: RobotClient, kind: Any, model: RobotModel, publish: Callable[[Any], None]) -> None:
        super().__init__(robot, kind)
        self._model, self._publish = model, publish

    def refusal(self, request: Any) -> Outcome | None:
        """Refuse unknown joints, and rename the others to the model's names; the controller checks the rest."""
        codes, trajectory = self._kind.Result, request.trajectory
        try:
            names = trajectory.joint_names = list(self._model.named(trajectory.joint_names))
            for each in request.goal_tolerance:
                (each.name,) = self._model.named([each.name])
        except JointNameError as error:
            return Outcome(False, str(error), code=codes.INVALID_JOINTS)
        if not names:
            return Outcome(False, "joint_names is empty", code=codes.INVALID_JOINTS)
        absent = [each.name for each in request.goal_tolerance if each.name not in names]
        if absent:
            message = f"goal_tolerance: joint '{absent[0]}' is not in the trajectory"
            return Outcome(False, message, code=codes.INVALID_GOAL)
        if request.multi_dof_trajectory.points:
            return Outcome(
                False, "multi_dof_trajectory: not supported, the robot has single joints only", code=codes.INVALID_GOAL
            )
        return None

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Execute the goal; see ``FollowJointTrajectory.action``."""
        robot, asked, codes = self._robot, handle.request, self._kind.Result
        names = list(asked.trajectory.joint_names)
        robot.begin()
        self._publish(asked.trajectory)
        feedback = partial(self._feedback, handle, names)
        outcome = await track_motion(handle, robot, turn, feedback, planned=False)
        if not outcome.success:
            return outcome
        worst = self._outside(asked, names)
        return Outcome(False, worst, code=codes.GOAL_TOLERANCE_VIOLATED) if worst else outcome

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome; a cancelled goal is not an error, as in ros2_controllers."""
        codes = self._kind.Result
        code = codes.SUCCESSFUL if outcome.success or outcome.cancelled else outcome.code or codes.INVALID_GOAL
        return codes(error_code=code, error_string="" if outcome.success else outcome.message)

    def _feedback(self, handle: Any, names: list[str], state: str) -> None:
        posture = self._robot.posture
        if posture is None:
            return
        message = self._kind.Feedback(joint_names=names)
        message.desired.positions = doubles(np.array([posture[self._model.joint_index(name)] for name in names]))
        handle.publish_feedback(message)

    def _outside(self, asked: Any, names: list[str]) -> str:
        """Message for the first joint that ended outside its tolerance, with its error; empty without one."""
        posture = self._robot.posture
        last = dict(zip(names, asked.trajectory.points[-1].positions, strict=True))
        for tolerance in asked.goal_tolerance:
            if tolerance.position <= 0.0:
                continue
            if posture is None:
                return f"final position of '{tolerance.name}' unknown: no reference posture was received"
            error = abs(posture[self._model.joint_index(tolerance.name)] - last[tolerance.name])
            if error > tolerance.position:
                return f"'{tolerance.name}' ended {error:.4f} rad off, tolerance {tolerance.position:.4f}"
        return ""


class WalkTo(Action):
    """Walks to a pose in ``odom``; the gait planner checks the goal, ``publish`` publishes it on ``goal_pose``."""

    def __init__(self, robot: RobotClient, kind: Any, publish: Callable[[Any], None]) -> None:
        super().__init__(robot, kind)
        self._publish = publish

    def refusal(self, request: Any) -> Outcome | None:
        """Refuse goals that are not a pose in ``odom``; the gait planner checks the rest."""
        try:
            goal_from_message("goal", request.goal)
        except MessageError as error:
            return Outcome(False, str(error))
        return None

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Execute the goal; see ``WalkTo.action``."""
        robot = self._robot
        robot.begin()
        reply = await robot.set_mode(Mode.WALK)
        if not reply.accepted:
            return Outcome(False, reply.reason)
        if not await robot.until(lambda: robot.mode == Mode.WALK.value, robot.config.answer_timeout):
            return await self._stand(Outcome(False, f"the walk did not begin: {robot.present_mode}"))
        robot.gait_ready = False
        outcome = await self._walk(handle, turn)
        return await self._stand(outcome) if outcome else Outcome(False, "replaced by a goal of another client")

    async def _walk(self, handle: Any, turn: Turn) -> Outcome | None:
        """Walk to the goal; None when the robot follows a newer goal of another client."""
        robot, goal, begin = self._robot, handle.request.goal, time.monotonic()
        next_time, config, sent = begin, robot.config, 0
        while True:
            now = time.monotonic()
            newest = robot.route[-1] if robot.route else RouteStatus(RouteState.ENDED)
            running = robot.routes_begun
            if running > sent:
                return None
            if why := turn.ended or ("" if robot.mode == Mode.WALK.value else robot.present_mode):
                return Outcome(False, why)
            if handle.is_cancel_requested:
                return Outcome(False, "cancelled", cancelled=True)
            if running and newest.state is RouteState.DONE:
                return Outcome(True, "goal reached")
            if newest.state is RouteState.REFUSED or (running and newest.state is not RouteState.RUNNING):
                return Outcome(False, newest.reason)
            if not running and now - begin > config.answer_timeout:
                return Outcome(False, newest.reason or f"no answer to the goal within {config.answer_timeout:g} s")
            if now - begin > config.walk_timeout:
                return Outcome(False, f"goal not reached within {config.walk_timeout:g} s")
            if not running and robot.gait_ready and now >= next_time:
                next_time, sent = now + config.goal_period, sent + 1
                self._publish(goal)
            if robot.feedback_due:
                left = robot.distance(goal.pose.position.x, goal.pose.position.y)
                handle.publish_feedback(self._kind.Feedback(distance=left, route=str(newest) if robot.route else ""))
            await robot.turn()

    async def _stand(self, outcome: Outcome) -> Outcome:
        """Stop the walk after any outcome; the goal fails if the walk does not stop."""
        robot = self._robot
        if robot.mode != Mode.WALK.value:
            return outcome
        timeout = robot.config.stand_timeout
        try:
            reply = await robot.set_mode(Mode.STAND)
        except CommandError as error:
            reply = CommandReply(False, str(error))
        if reply.accepted and await robot.until(lambda: robot.mode != Mode.WALK.value, timeout):
            return Outcome(outcome.success, f"{outcome.message}; mode '{robot.mode}'", outcome.cancelled)
        reason = f"the walk did not stop within {timeout:g} s" if reply.accepted else reply.reason
        return Outcome(False, f"{outcome.message}; the robot did not stop: {reason}", outcome.cancelled)


FOLLOW = "joint_trajectory_controller/follow_joint_trajectory"  #: Name that MoveIt uses


class ActionServerNode(PoiseNode):
    """Offers ``execute_motion``, ``walk_to`` and ``joint_trajectory_controller/follow_joint_trajectory``.

    Its executor must support coroutines; rclpy's events executor does not.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("action_server", **kwargs)
        self._config = declare_config(self, default_config(ActionsConfig, "bridge", "actions"))
        known = default_config(SupervisorConfig, "controllers", "supervisor").motions
        text = describe("Motions of the supervisor; refusals list them")
        self._motions = self.declare_parameter("motions", list(known), text).value

    def configure(self) -> None:
        """Create the actions; raises ``MessageError`` with the build command if their types are not built."""
        motion, walk = (interface("poise_interfaces", "action", name) for name in ("ExecuteMotion", "WalkTo"))
        robot = RobotClient(self, self._config)
        self._turns = Turns(robot)
        goals = self.announce(PoseStamped, topics.GOAL_POSE, EVENT)
        self._offer(motion, "execute_motion", ExecuteMotion(robot, motion, (*self._motions, "stand")))
        self._offer(walk, "walk_to", WalkTo(robot, walk, goals.publish))
        try:
            follow = interface("control_msgs", "action", "FollowJointTrajectory")
        except MessageError as error:
            self.values[FOLLOW] = str(error)
            return
        motions = self.announce(JointTrajectory, topics.JOINT_TRAJECTORY, EVENT)
        self._offer(follow, FOLLOW, FollowJointTrajectory(robot, follow, self.model, motions.publish))

    def activate(self) -> None:
        self._turns.closed = False

    def deactivate(self) -> None:
        """End the present goal and accept no further ones."""
        self._turns.closed = True

    def _offer(self, kind: Any, name: str, action: Action) -> None:
        server = ActionServer(
            self,
            kind,
            name,
            goal(self._turns, action, partial(self.refuse, name)),
            goal_callback=lambda request: GoalResponse.ACCEPT if self.active else GoalResponse.REJECT,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
        )
        self.own(ActionServer.destroy, server)


main = program(ActionServerNode, make=SingleThreadedExecutor)

if __name__ == "__main__":
    main()
