"""Motions of the balance controller: requests and trajectories in, their status out."""

from __future__ import annotations

import zlib
from collections.abc import Callable

from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from controllers.safety.supervisor import ACTIVE_MODES
from controllers.stack import ControlStack
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import decode, trajectory_from_message
from models.nodes.qos import EVENT
from models.status import MotionState, MotionStatus
from models.types import Mode

#: Largest accepted trajectory [bytes]: 600 points of 32 joints with velocities have 340 000, decoded in some 30 ms; the
#: drivers wait 40 ms for the next command
TRAJECTORY_BYTES_MAX = 400_000


class MotionTopics:
    """In mode motion, has the law follow the answer to the newest request, or a trajectory without a request.

    In mode walk motions use arms and head only. ``requested`` is the newest request, empty before the first.
    """

    def __init__(self, node: PoiseNode, stack: ControlStack, mode: Callable[[], Mode]) -> None:
        self._node, self._stack, self._mode = node, stack, mode
        self._running = False
        self.requested = ""
        self._state = node.announce(String, topics.MOTION_STATE, EVENT)
        self._publish_status = node.announce_status(topics.MOTION_STATUS)
        node.listen(JointTrajectory, topics.MOTION_TRAJECTORY, self._on_trajectory, EVENT, raw=True)
        node.listen(String, topics.MOTION_REQUEST, self._on_request, EVENT)

    def forget(self) -> None:
        """The law starts over: no motion runs."""
        self._running = False

    def tell_end(self) -> None:
        """Publish, after a tick, that the motion has ended."""
        if self._running and not self._stack.motion_active:
            self._publish(MotionState.DONE)

    def _publish(self, state: MotionState, request: str = "", reason: str = "") -> None:
        self._running = state is MotionState.RUNNING
        status = MotionStatus(state, request, reason)
        self._publish_status(status)
        self._state.publish(String(data=str(status)))

    def _on_request(self, message: String) -> None:
        self.requested = message.data
        if message.data == topics.STOP_MOTION and self._running:
            self._stack.stop_motion()
            self._publish(MotionState.DONE)

    def _on_trajectory(self, data: bytes) -> None:
        request, mode = "", self._mode()
        try:
            if len(data) > TRAJECTORY_BYTES_MAX:  # decoding would cost ticks that keep the robot standing
                raise MessageError(f"{len(data)} bytes, at most {TRAJECTORY_BYTES_MAX}: leave out points")
            message = decode(data, JointTrajectory)
            request = message.header.frame_id
            wanted = mode in (Mode.MOTION, Mode.WALK) and request == self.requested if request else True
            if not wanted:
                raise PoiseError(f"'{request[:32]}' came too late: mode '{mode.value}' goes on")
            if not self._node.active or mode not in ACTIVE_MODES or (mode is Mode.WALK and not request):
                raise PoiseError(f"no motion in mode '{mode.value}'")
            self._stack.follow(trajectory_from_message(message), zlib.crc32(data))
        except PoiseError as error:
            self._node.refuse(topics.MOTION_TRAJECTORY, error)
            if not self._running:
                self._publish(MotionState.REFUSED, request, str(error))
            return
        self._publish(MotionState.RUNNING)
