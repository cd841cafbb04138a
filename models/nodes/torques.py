"""sensor_msgs/JointState with torques alone: what is asked of motors."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import JointState

from models.errors import MessageError
from models.nodes.cdr import Markers, Template, stamp_of
from models.nodes.messages import decode, doubles, require_finite
from models.robot_model import RobotModel
from models.types import Vector


class TorqueCodec:
    """Torques of every joint of one robot, by name; no positions and no velocities.

    Args:
        model: The robot.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        slot = Markers().take(model.nj)
        self._template = Template(JointState(name=list(model.joint_names), effort=doubles(slot)), [slot])

    def encode(self, stamp: int, tau: Vector) -> bytes:
        """Serialised message from a stamp [ns] and torques (nj,) [N.m]."""
        return self._template.pack(stamp, (tau,))

    def decode(self, data: bytes) -> tuple[int, Vector]:
        """Stamp [ns] and torques (nj,) in the order of ``RobotModel.joint_names``.

        Raises:
            JointNameError: A joint is missing, unknown or given twice.
            MessageError: Bad size or stamp, NaN or infinity.
        """
        values = self._template.unpack(data)
        if values is None:
            message = decode(data, JointState)
            numbers = np.frombuffer(message.effort, dtype=np.float64)
            if len(numbers) != len(message.name):
                raise MessageError(f"effort: {len(numbers)} values for {len(message.name)} names")
            values = [self._model.reorder(list(message.name), numbers)]
        require_finite("effort", values[0], self._model.joint_names)
        return stamp_of(data), values[0]
