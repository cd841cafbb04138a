"""Pan and tilt of the head: target in, measured angles out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import JointState

from controllers.safety.supervisor import ACTIVE_MODES
from controllers.stack import ControlStack
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import head_from_message, head_message
from models.nodes.qos import EVENT, SENSOR
from models.types import Mode, RobotState


class HeadTopics:
    """Turns the head to ``head/pan_tilt``; refused by name without a head, or in modes without motion."""

    def __init__(self, node: PoiseNode, stack: ControlStack, mode: Callable[[], Mode]) -> None:
        self._node, self._stack, self._mode = node, stack, mode
        head = node.model.profile.head
        self._joints = None if head is None else [node.model.joint_index(name) for name in (head.pan, head.tilt)]
        if self._joints is not None:
            self._state = node.announce(JointState, topics.HEAD_STATE, SENSOR)
        node.listen(JointState, topics.HEAD_COMMAND, self._on_command, EVENT)

    def tell(self, state: RobotState, stamp: int) -> None:
        """Publish the head's angles of a state with a stamp [ns]; nothing for a robot without a head."""
        if self._joints is not None:
            pan, tilt = state.q[7:][self._joints].tolist()
            self._state.publish(head_message(stamp, pan, tilt))

    def _on_command(self, message: Any) -> None:
        mode = self._mode()
        try:
            pan, tilt = head_from_message(message)
            if self._joints is not None and not (self._node.active and mode in ACTIVE_MODES):
                raise PoiseError(f"the head is not moved in mode '{mode.value}'")
            self._stack.look(pan, tilt)
        except PoiseError as error:
            self._node.refuse(topics.HEAD_COMMAND, error)
