"""Where the robot is, as transforms: ``/tf`` and ``/tf_static``, also where ``tf2_msgs`` is not installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from models.errors import MessageError
from models.footprint import base_footprint
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.qos import EVENT, LATCHED
from models.nodes.tf_type import tf_message_type
from models.nodes.transforms import TransformsCodec
from models.robot_model import RobotModel
from models.types import RobotState, Vector

_MOVING_FRAMES = ((topics.ODOM_FRAME, topics.BASE_FRAME), (topics.BASE_FRAME, topics.FOOTPRINT_FRAME))


class TransformTopics:
    """Publishes the moving frames, and once those that sit on links; nothing where ROS 2 has no message for it.

    Args:
        node: Node that publishes.
    """

    def __init__(self, node: PoiseNode) -> None:
        self._node = node
        self._workspace = node.model.data()
        self._soles = [foot.frame_id for foot in node.model.feet]
        self._codec = TransformsCodec(_MOVING_FRAMES)
        base_footprint(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), np.zeros((2, 3)))  # compiles now, not in a tick
        self._moving: Any = None
        try:
            kind = tf_message_type()
        except MessageError as error:
            node.get_logger().warning(f"no transforms on {topics.TF}: {error}")
            node.values[topics.TF] = str(error)
            return
        self._static = node.announce(kind, topics.TF_STATIC, LATCHED)
        self._moving = node.announce(kind, topics.TF, EVENT)

    def start(self, stamp: int) -> None:
        """Publish what does not change, for a robot that begins to be estimated at a stamp [ns]."""
        if self._moving is None:
            return
        frames = static_frames(self._node.model)
        codec = TransformsCodec([(parent, child) for parent, child, _ in frames])
        self._static.publish(codec.encode(stamp, [pose for _, _, pose in frames]))

    def publish(self, state: RobotState, stamp: int) -> None:
        """Publish the moving frames of a state at its stamp [ns]."""
        if self._moving is not None:
            self._moving.publish(self._codec.encode(stamp, [state.q[:7], self._footprint(state)]))

    def _footprint(self, state: RobotState) -> Vector:
        model, data = self._node.model.pin, self._workspace
        pin.forwardKinematics(model, data, state.q)
        soles = np.array([pin.updateFramePlacement(model, data, sole).translation for sole in self._soles])
        return base_footprint(state.q[:7], soles)


def static_frames(model: RobotModel) -> list[tuple[str, str, Any]]:
    """REP-120 frames that sit on links of the URDF: what ``robot_state_publisher`` cannot know.

    The root link hangs under ``base_link``, so that the tree stays one. A frame named as one of the links is that link
    and left out.

    Args:
        model: The robot.

    Returns:
        Parent, child and pose (7,) of the child in its parent, for each.
    """
    root = model.profile.base_link
    frames = [] if root == topics.BASE_FRAME else [(topics.BASE_FRAME, root, pin.SE3ToXYZQUAT(pin.SE3.Identity()))]
    for name in model.frame_names:
        frame = model.pin.frames[model.frame_id(name)]
        link = model.pin.frames[frame.parentFrame]
        if name == topics.BASE_FRAME or model.pin.existFrame(name, pin.FrameType.BODY):
            continue
        frames.append((link.name, name, pin.SE3ToXYZQUAT(link.placement.actInv(frame.placement))))
    return frames
