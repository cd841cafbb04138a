"""Turns joint positions into whole-body references for a robot whose soles stay where they are."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from models.robot_model import RobotModel
from models.types import Matrix, Vector


class PostureReference:
    """CoM and orientations that a posture has when its soles stand on the anchor.

    The anchor is the frame half-way between the soles. With ``T_mid_B(q)`` the base in that frame by forward
    kinematics, ``T_WB = T_W_anchor T_mid_B``.

    Args:
        model: The robot.

    Attributes:
        com: CoM in the anchor frame (3,) [m].
        base: Rotation of the base in the anchor frame (3, 3).
        torso: Rotation of the torso in the anchor frame (3, 3).
    """

    def __init__(self, model: RobotModel) -> None:
        self._pin = model.pin
        self._data = model.data()
        self._soles = tuple(foot.frame_id for foot in model.feet)
        self._torso = model.frame_id("torso")
        self._q = pin.neutral(model.pin)
        self.com = np.zeros(3)
        self.base = np.eye(3)
        self.torso = np.eye(3)

    def update(self, joints: Vector) -> None:
        """Evaluate a posture (nj,) [rad]."""
        self._q[7:] = joints
        model, data = self._pin, self._data
        pin.centerOfMass(model, data, self._q, False)
        left = pin.updateFramePlacement(model, data, self._soles[0])
        right = pin.updateFramePlacement(model, data, self._soles[1])
        torso = pin.updateFramePlacement(model, data, self._torso)
        rotation, middle = middle_frame(left.rotation, left.translation, right.rotation, right.translation)
        self.base = rotation.T
        self.torso = rotation.T @ torso.rotation
        self.com = rotation.T @ (data.com[0] - middle)


def middle_frame(
    left_rotation: Matrix, left_position: Vector, right_rotation: Matrix, right_position: Vector
) -> tuple[Matrix, Vector]:
    """Rotation (3, 3) and origin (3,) of the frame half-way between two soles."""
    turn = pin.log3(left_rotation.T @ right_rotation)
    return left_rotation @ pin.exp3(0.5 * turn), 0.5 * (left_position + right_position)
