"""Turns joint positions into whole-body references for a robot whose soles stay where they are."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from controllers.kernels_posture import TREE, posture_reference
from controllers.memory import Block
from models.errors import RobotModelError
from models.robot_model import RobotModel
from models.types import Vector


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
        tree: Kinematic tree, for kernels.
        parents: Parent body of each joint (nj,); body 0 is the base.
        bodies: Body that carries the left sole, the right sole and the torso frame (3,).

    Raises:
        RobotModelError: A joint is not revolute; names it.
    """

    def __init__(self, model: RobotModel) -> None:
        nj = model.nj
        self.com, self.base, self.torso = np.zeros(3), np.eye(3), np.eye(3)
        shapes = ((nj, 3, 3), (nj, 3, 3), (nj, 3, 3), (nj, 3), (nj + 1,), (nj + 1, 3), (3, 3, 3), (3, 3))
        self.tree = Block(dict(zip(TREE, shapes, strict=True)))
        self.parents = np.zeros(nj, dtype=np.int64)
        self.bodies = np.zeros(3, dtype=np.int64)
        self._read(model)

    def _read(self, model: RobotModel) -> None:
        """Copy the tree off Pinocchio's model; body k is joint k + 1 there, the base being body 0."""
        robot, data = model.pin, model.data()
        neutral = pin.neutral(robot)
        for n in range(model.nj):
            joint = n + 2
            if robot.nvs[joint] != 1:
                raise RobotModelError(f"joint '{robot.names[joint]}' is not revolute")
            subspace = pin.computeJointJacobian(robot, data, neutral, joint)[:, robot.idx_vs[joint]]  # (6,)
            if np.abs(subspace[:3]).max() > 1e-12 or robot.idx_vs[joint] != n + 6:
                raise RobotModelError(f"joint '{robot.names[joint]}' is not revolute")
            placement = robot.jointPlacements[joint]
            self.parents[n] = robot.parents[joint] - 1
            self.tree["rotations"][n] = placement.rotation
            self.tree["translations"][n] = placement.translation
            cross = pin.skew(subspace[3:])
            self.tree["swings"][n] = placement.rotation @ cross
            self.tree["bends"][n] = placement.rotation @ cross @ cross
        for body in range(model.nj + 1):
            self.tree["masses"][body] = robot.inertias[body + 1].mass / model.mass
            self.tree["levers"][body] = robot.inertias[body + 1].lever
        for k, frame_id in enumerate((*(foot.frame_id for foot in model.feet), model.frame_id("torso"))):
            frame = robot.frames[frame_id]
            self.bodies[k] = frame.parentJoint - 1
            self.tree["frame_rotations"][k] = frame.placement.rotation
            self.tree["frame_translations"][k] = frame.placement.translation

    def update(self, joints: Vector) -> None:
        """Evaluate a posture (nj,) [rad]."""
        tree = self.tree
        posture_reference(joints, tree.data, tree.layout, self.parents, self.bodies, self.com, self.base, self.torso)
