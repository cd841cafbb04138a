"""Motions and head of the balance controller: requests, trajectories and head targets in, their status out."""

import zlib
from collections.abc import Callable
from functools import partial
from typing import Any

from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from controllers.safety.supervisor import ACTIVE_MODES
from controllers.stack import ControlStack
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import decode, head_from_message, head_message, trajectory_from_message
from models.nodes.qos import EVENT, STATE
from models.status import MotionState, MotionStatus
from models.types import Mode, RobotState

#: Largest accepted trajectory [bytes]: 600 points of 32 joints with velocities have 340 000, decoded in some 30 ms; the
#: drivers wait 40 ms for the next command
TRAJECTORY_BYTES_MAX = 400_000


class MotionTopics:
    """Follows the trajectory that answers the newest request, or one without a request (not in mode walk).

    In mode walk, motions use arms and head only. ``requested`` is the newest request, empty before the first.
    """

    def __init__(self, node: PoiseNode, stack: ControlStack, mode: Callable[[], Mode]) -> None:
        self._node, self._stack, self._mode = node, stack, mode
        self._running = False
        self.requested = ""
        self._state = node.announce(String, topics.MOTION_STATE, EVENT)
        self._publish_status = node.announce_status(topics.MOTION_STATUS)
        for topic in (topics.JOINT_TRAJECTORY, topics.MOTION_TRAJECTORY):
            node.listen(JointTrajectory, topic, partial(self._on_trajectory, topic), EVENT, raw=True)
        node.listen(String, topics.MOTION_REQUEST, self._on_request, EVENT)

    def end(self, reason: str) -> None:
        """Publish that a running motion has ended early."""
        if self._running:
            self._publish(MotionState.ENDED, reason=reason)

    def publish_end(self) -> None:
        """Publish, after a tick, that the motion has ended."""
        if self._running and not self._stack.motion_active:
            self._publish(MotionState.DONE)

    def _publish(self, state: MotionState, request: str = "", reason: str = "") -> None:
        if state is not MotionState.REFUSED:  # a running motion continues
            self._running = state is MotionState.RUNNING
        status = MotionStatus(state, request, reason)
        self._publish_status(status)
        self._state.publish(String(data=str(status)))

    def _on_request(self, message: String) -> None:
        self.requested = message.data
        if message.data == topics.STOP_MOTION and self._running:
            self._stack.stop_motion()
            self.end("stopped")

    def _on_trajectory(self, topic: str, data: bytes) -> None:
        request, mode = "", self._mode()
        try:
            if len(data) > TRAJECTORY_BYTES_MAX:  # decoding would delay the ticks that balance the robot
                raise MessageError(f"{len(data)} bytes, at most {TRAJECTORY_BYTES_MAX}: send fewer points")
            message = decode(data, JointTrajectory)
            request = message.header.frame_id if topic == topics.MOTION_TRAJECTORY else ""
            if request and not (mode in (Mode.MOTION, Mode.WALK) and request == self.requested):
                raise PoiseError(f"'{request[:32]}' arrived too late: mode '{mode.value}' continues")
            if not self._node.active or mode not in ACTIVE_MODES or (mode is Mode.WALK and not request):
                raise PoiseError(f"no trajectory in mode '{mode.value}': first poise mode stand")
            self._stack.follow(trajectory_from_message(message), zlib.crc32(data))
        except PoiseError as error:
            self._publish(MotionState.REFUSED, request, str(error))
            raise
        self._publish(MotionState.RUNNING)


class HeadTopics:
    """Moves the head to ``head/pan_tilt``; refused with the reason without a head, or outside active modes."""

    def __init__(self, node: PoiseNode, stack: ControlStack, mode: Callable[[], Mode]) -> None:
        self._node, self._stack, self._mode = node, stack, mode
        head = node.model.profile.head
        self._joints = None if head is None else [node.model.joint_index(name) for name in (head.pan, head.tilt)]
        if self._joints is not None:
            self._state = node.announce(JointState, topics.HEAD_STATE, STATE)
        node.listen(JointState, topics.HEAD_COMMAND, self._on_command, EVENT)

    def publish(self, state: RobotState, stamp: int) -> None:
        """Publish the head angles of a state with its stamp [ns]; nothing without a head."""
        if self._joints is not None:
            pan, tilt = state.q[7:][self._joints].tolist()
            self._state.publish(head_message(stamp, pan, tilt))

    def _on_command(self, message: Any) -> None:
        mode = self._mode()
        pan, tilt = head_from_message(message)
        if self._joints is not None and not (self._node.active and mode in ACTIVE_MODES):
            raise PoiseError(f"the head does not move in mode '{mode.value}': first poise mode stand")
        self._stack.look(pan, tilt)
