"""Pan and tilt of the head: where it is sent in, where it is out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import JointState

from controllers.law_switch import LawSwitch
from controllers.supervisor import ACTIVE_MODES
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.head import head_from_message, head_message
from models.nodes.qos import EVENT, SENSOR
from models.types import Mode, RobotState


class HeadTopics:
    """Sends the head where ``head/pan_tilt`` says; refused by name where there is none, or while nothing moves.

    Args:
        node: Node that subscribes.
        laws: Turn the head.
        mode: Present mode of the robot.
    """

    def __init__(self, node: PoiseNode, laws: LawSwitch, mode: Callable[[], Mode]) -> None:
        self._node, self._laws, self._mode = node, laws, mode
        head = node.model.profile.head
        self._joints = None if head is None else [node.model.joint_index(name) for name in (head.pan, head.tilt)]
        if self._joints is not None:
            self._state = node.announce(JointState, topics.HEAD_STATE, SENSOR)
        node.listen(JointState, topics.HEAD_COMMAND, self._on_command, EVENT)

    def tell(self, state: RobotState, stamp: int) -> None:
        """Publish where the head is by a state with a stamp [ns]; nothing for a robot without."""
        if self._joints is not None:
            pan, tilt = state.q[7:][self._joints].tolist()
            self._state.publish(head_message(stamp, pan, tilt))

    def _on_command(self, message: Any) -> None:
        mode = self._mode()
        try:
            pan, tilt = head_from_message(message)
            if self._joints is not None and not (self._node.active and mode in ACTIVE_MODES):
                raise PoiseError(f"the head is not moved in mode '{mode.value}'")
            self._laws.look(pan, tilt)
        except PoiseError as error:
            self._node.refuse(topics.HEAD_COMMAND, error)
