"""Service ``plan_motion``: the pose of a hand in, the trajectory that brings it there out, executed where asked."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.deferred import Owed, serve_later
from models.nodes.head import head_from_message
from models.nodes.messages import trajectory_to_message
from models.nodes.odometry import OdometryCodec
from models.nodes.own_types import offer_own
from models.nodes.qos import EVENT, LATCHED, SENSOR
from models.trajectory import thin
from models.types import JointTrajectory, Mode, Vector
from planners.motion import MotionPlanner
from planners.target import frame_named, planted_target

BEGIN_TIMEOUT = 2.0
"""Longest wait for the controller's word on a trajectory [s]; one that is refused beside a running one gets none."""

LOOK_PERIOD = 0.05
"""Between two looks at that time [s]."""


class MotionService:
    """Plans with ``MotionPlanner.plan_pose`` from the posture of a robot in mode ``stand``.

    Args:
        node: Node that offers it.
        law: Plans.
        posture: Reference posture of the controller (nj,) [rad]; raises ``MessageError`` before the first.
        publish: Publishes a trajectory on ``motion/joint_trajectory``.
        points_max: Points of a trajectory, as of every one that the node publishes.
    """

    def __init__(
        self,
        node: PoiseNode,
        law: MotionPlanner,
        posture: Callable[[], Vector],
        publish: Callable[[Any], None],
        points_max: int,
    ) -> None:
        self._node, self._law, self._posture, self._publish = node, law, posture, publish
        self._points_max, self._odometry = points_max, OdometryCodec()
        self._mode, self._odom = "", b""
        self._head: tuple[float, float] | None = None
        self._owed: tuple[Owed, Any] | None = None
        self._until = 0.0
        node.listen(String, topics.MODE, self._on_mode, LATCHED)
        node.listen(String, topics.MOTION_STATE, self._on_state, EVENT)
        node.listen(Odometry, topics.ODOM, self._on_odom, SENSOR, raw=True)
        node.listen(JointState, topics.HEAD_STATE, self._on_head, SENSOR)
        node.own(node.destroy_timer, node.every(LOOK_PERIOD, self._look))
        offer_own(node, "PlanMotion", topics.PLAN_MOTION, self._on_call, serve_later)

    def _on_call(self, request: Any, response: Any) -> Any:
        try:
            trajectory = self._plan(request)
        except PoiseError as error:
            self._node.refuse(topics.PLAN_MOTION, error)
            response.success, response.message = False, str(error)
            return response
        response.trajectory = trajectory_to_message(thin(trajectory, self._points_max))
        response.success, response.message = True, f"{request.frame} gets there in {trajectory.times[-1]:.2f} s"
        if not request.execute:
            return response
        self._publish(response.trajectory)
        self._owed, self._until = (Owed(), response), time.monotonic() + BEGIN_TIMEOUT
        return self._owed[0]

    def _plan(self, request: Any) -> JointTrajectory:
        if not self._node.active:
            raise CommandError("the motion planner is not active")
        if self._mode != Mode.STAND.value:
            raise CommandError(f"plans are made for a robot that stands, not in mode '{self._mode or 'unknown'}'")
        if self._owed is not None:
            raise CommandError("another plan is just beginning to be executed")
        frame, pose, joints = frame_named(request.frame), request.target.pose, self._posture()
        turn = np.array([getattr(pose.orientation, axis) for axis in "xyzw"])
        if not request.use_orientation and not np.array_equal(turn, (0.0, 0.0, 0.0, 1.0)):
            raise CommandError("target: an orientation is given, but use_orientation is false")
        place = np.array([getattr(pose.position, axis) for axis in "xyz"])
        base = self._odometry.decode(self._odom)[1] if self._odom else None
        model = self._node.model
        target = planted_target(model, self._seen(joints), request.target.header.frame_id, place, turn, base)
        return self._law.plan_pose(
            frame,
            target.translation,
            pin.Quaternion(target.rotation).coeffs() if request.use_orientation else None,
            start_q=joints,
            duration=request.duration if request.duration != 0.0 else None,
        )

    def _seen(self, joints: Vector) -> Vector:
        """A posture with the head where it is (nj,) [rad].

        Plans start below what ``head/pan_tilt`` adds; a target in a frame of the head, such as its camera's, does not.
        """
        head = self._node.model.profile.head
        if head is None or self._head is None:
            return joints
        seen = joints.copy()
        seen[[self._node.model.joint_index(name) for name in (head.pan, head.tilt)]] = self._head
        return seen

    def _on_head(self, message: Any) -> None:
        try:
            self._head = head_from_message(message)
        except PoiseError as error:
            self._node.refuse(topics.HEAD_STATE, error)

    def _on_mode(self, message: String) -> None:
        self._mode = message.data

    def _on_odom(self, data: bytes) -> None:
        self._odom = data

    def _on_state(self, message: String) -> None:
        """What the controller does with the trajectory."""
        word, _, reason = message.data.partition(": ")
        if word == topics.MOTION_RUNNING:
            self._answer("")
        elif word == topics.MOTION_REFUSED:
            self._answer(f"the controller refuses it: {reason}")

    def _look(self) -> None:
        if self._owed is not None and time.monotonic() > self._until:
            self._answer("the controller does not say that it follows it")

    def _answer(self, problem: str) -> None:
        if self._owed is None:
            return
        (owed, response), self._owed = self._owed, None
        if problem:
            self._node.refuse(topics.PLAN_MOTION, problem)
            response.success, response.message = False, problem
        owed.answer(response)
