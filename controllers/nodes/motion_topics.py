"""Motions of the balance controller: requests and trajectories in, what became of them out."""

from __future__ import annotations

import zlib
from collections.abc import Callable

from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from controllers.law_switch import LawSwitch
from controllers.supervisor import ACTIVE_MODES
from models.applied import Applied
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import decode, trajectory_from_message
from models.nodes.qos import EVENT
from models.types import Mode

TRAJECTORY_BYTES_MAX = 400_000
"""Largest trajectory that is decoded [bytes]. 600 points of 32 joints with velocities have 340 000; to read the largest
takes some 30 ms, and the drivers wait 40 ms for the next command."""


class MotionTopics:
    """Has the law follow the answer to the newest request while in mode motion, or what came without a request.

    Args:
        node: Node that subscribes.
        law: Follows the motions; in mode walk with arms and head only.
        mode: Present mode of the robot.
        applied: Notes which motion is followed, for a replay; None for nobody.

    Attributes:
        requested: Newest request; empty before the first.
    """

    def __init__(
        self, node: PoiseNode, law: LawSwitch, mode: Callable[[], Mode], applied: Applied | None = None
    ) -> None:
        self._node, self._law, self._mode, self._applied = node, law, mode, applied
        self._running = False
        self.requested = ""
        self._state = node.announce(String, topics.MOTION_STATE, EVENT)
        node.listen(JointTrajectory, topics.MOTION_TRAJECTORY, self._on_trajectory, EVENT, raw=True)
        node.listen(String, topics.MOTION_REQUEST, self._on_request, EVENT)

    def forget(self) -> None:
        """The law starts over: no motion runs."""
        self._running = False

    def tell_end(self) -> None:
        """Tell, after a tick, that the motion has ended."""
        if self._running and not self._law.motion_active:
            self._tell(topics.MOTION_DONE)

    def _tell(self, word: str, reason: str = "") -> None:
        self._running = word == topics.MOTION_RUNNING
        self._state.publish(String(data=f"{word}: {reason}" if reason else word))

    def _on_request(self, message: String) -> None:
        self.requested = message.data
        if message.data == topics.STOP_MOTION and self._running:
            self._law.stop_motion()
            self._tell(topics.MOTION_DONE)

    def _on_trajectory(self, data: bytes) -> None:
        request, mode = "", self._mode()
        try:
            if len(data) > TRAJECTORY_BYTES_MAX:  # its decoding would take ticks that keep the robot standing
                raise MessageError(f"{len(data)} bytes, at most {TRAJECTORY_BYTES_MAX}: leave out points")
            message = decode(data, JointTrajectory)
            request = message.header.frame_id
            wanted = mode in (Mode.MOTION, Mode.WALK) and request == self.requested if request else True
            if not wanted:
                raise PoiseError(f"'{request[:32]}' came too late: mode '{mode.value}' goes on")
            if not self._node.active or mode not in ACTIVE_MODES or (mode is Mode.WALK and not request):
                raise PoiseError(f"no motion in mode '{mode.value}'")
            trajectory = trajectory_from_message(message)
            self._law.follow(trajectory)
            if self._applied is not None:
                self._applied.follow(zlib.crc32(data), trajectory)
        except PoiseError as error:
            self._node.refuse(topics.MOTION_TRAJECTORY, error)
            if not self._running:
                self._tell(topics.MOTION_REFUSED, f"{request}: {error}" if request else str(error))
            return
        self._tell(topics.MOTION_RUNNING)
