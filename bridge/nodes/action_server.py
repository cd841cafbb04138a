"""Node ``action_server``: long motions as ROS 2 actions, made of the topics and services of the graph."""

from __future__ import annotations

import sys
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import SingleThreadedExecutor
from trajectory_msgs.msg import JointTrajectory

from bridge.actions.motion import ExecuteMotion, FollowJointTrajectory, WalkTo
from bridge.actions.robot import Action, ActionsConfig, RobotClient, Turns, goal
from models.config import default_config
from models.errors import MessageError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.interfaces import interface
from models.nodes.parameters import declare_config
from models.nodes.qos import EVENT
from models.nodes.spin import run

FOLLOW = "joint_trajectory_controller/follow_joint_trajectory"  #: Name that MoveIt uses


class ActionServerNode(PoiseNode):
    """Offers ``execute_motion``, ``walk_to`` and ``joint_trajectory_controller/follow_joint_trajectory``.

    Its executor must await coroutines: rclpy's events executor does not.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("action_server", **kwargs)
        self._config = declare_config(self, default_config(ActionsConfig, "bridge", "actions"))

    def configure(self) -> None:
        """Build the actions; refused without their types, with the command that builds them."""
        motion, walk = (interface("poise_interfaces", "action", name) for name in ("ExecuteMotion", "WalkTo"))
        robot = RobotClient(self, self._config)
        self._turns = Turns(robot)
        goals = self.announce(PoseStamped, topics.GOAL_POSE, EVENT)
        self._offer(motion, "execute_motion", ExecuteMotion(robot, motion))
        self._offer(walk, "walk_to", WalkTo(robot, walk, goals.publish))
        try:
            follow = interface("control_msgs", "action", "FollowJointTrajectory")
        except MessageError as error:
            self.values[FOLLOW] = str(error)
            return
        motions = self.announce(JointTrajectory, topics.MOTION_TRAJECTORY, EVENT)
        self._offer(follow, FOLLOW, FollowJointTrajectory(robot, follow, self.model, motions.publish))

    def activate(self) -> None:
        """Accept goals."""
        self._turns.closed = False

    def deactivate(self) -> None:
        """End the present goal and accept none."""
        self._turns.closed = True

    def _offer(self, kind: Any, name: str, action: Action) -> None:
        server = ActionServer(
            self,
            kind,
            name,
            goal(self._turns, action),
            goal_callback=lambda request: GoalResponse.ACCEPT if self.active else GoalResponse.REJECT,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
        )
        self.own(ActionServer.destroy, server)


def main(args: list[str] | None = None) -> None:
    """Run the node in a separate process."""
    sys.exit(run([ActionServerNode], args, make=SingleThreadedExecutor))


if __name__ == "__main__":
    main()
