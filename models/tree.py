"""Kinematics of the whole robot for compiled laws: Pinocchio's tree as a structured array.

Laws that need every body on every tick (posture reference, sole poses, generalised momentum) traverse the tree inside
their kernel. Passing a structured array to a kernel costs as little as passing one plain array.
"""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from models.errors import RobotModelError
from models.numerics.compiled import njit
from models.numerics.so3 import multiply, rotate

Array = NDArray[np.float64]

#: Records of ``BODY``, one per body (nj + 1,); body 0 is the base, joint n moves body n + 1
KinematicTree = NDArray[np.void]
#: Body and its joint: index of the parent body; rotation R of the joint frame in the parent at q = 0; swing = R
#: [axis]x; bend = R [axis]x [axis]x; origin of the joint frame in the parent [m]; axis in the joint frame; mass [kg];
#: CoM in the body frame (lever) [m]; inertia about the CoM [kg.m^2]. The rotation of the body in its parent at q is
#: R + sin q swing + (1 - cos q) bend.
BODY = np.dtype(
    [
        ("parent", np.int64),
        ("rotation", np.float64, (3, 3)),
        ("swing", np.float64, (3, 3)),
        ("bend", np.float64, (3, 3)),
        ("translation", np.float64, 3),
        ("axis", np.float64, 3),
        ("mass", np.float64),
        ("lever", np.float64, 3),
        ("inertia", np.float64, (3, 3)),
    ]
)
TreeFrames = NDArray[np.void]  #: Records of ``FRAME`` (k,)
#: Operational frame: index of the body, and pose in the body frame
FRAME = np.dtype([("body", np.int64), ("rotation", np.float64, (3, 3)), ("translation", np.float64, 3)])


def read_tree(model: pin.Model) -> KinematicTree:
    """Tree of a robot with a free flyer; ``RobotModelError`` names a joint that is not revolute."""
    tree = np.zeros(model.njoints - 1, dtype=BODY)
    for body, inertia in zip(tree, list(model.inertias)[1:], strict=True):
        body["mass"], body["lever"], body["inertia"] = inertia.mass, inertia.lever, inertia.inertia
    data, neutral = model.createData(), pin.neutral(model)
    for joint in range(2, model.njoints):
        subspace = pin.computeJointJacobian(model, data, neutral, joint)[:, model.idx_vs[joint]]  # (6,)
        if model.nvs[joint] != 1 or np.abs(subspace[:3]).max() > 1e-12 or model.idx_vs[joint] != joint + 4:
            raise RobotModelError(f"joint '{model.names[joint]}' is not revolute")
        body, placement, cross = tree[joint - 1], model.jointPlacements[joint], pin.skew(subspace[3:])
        body["parent"], body["axis"] = model.parents[joint] - 1, subspace[3:]
        body["rotation"], body["translation"] = placement.rotation, placement.translation
        body["swing"], body["bend"] = placement.rotation @ cross, placement.rotation @ cross @ cross
    return tree


def read_frames(model: pin.Model, frame_ids: Sequence[int]) -> TreeFrames:
    """Read operational frames from Pinocchio's model."""
    result = np.zeros(len(frame_ids), dtype=FRAME)
    for record, frame in zip(result, (model.frames[frame_id] for frame_id in frame_ids), strict=True):
        placement = frame.placement
        record["body"], record["rotation"] = frame.parentJoint - 1, placement.rotation
        record["translation"] = placement.translation
    return result


@njit(cache=True)
def place_bodies(tree: KinematicTree, joints: Array, rotations: Array, origins: Array) -> None:
    """Forward kinematics: rotations (nj + 1, 3, 3), origins (nj + 1, 3) [m]; index 0 (the base) is an input."""
    turn, step = np.empty((3, 3)), np.empty(3)
    for body in range(1, tree.shape[0]):
        record = tree[body]
        parent, q = record.parent, joints[body - 1]
        rotate(rotations[parent], record.translation, step)
        sine, rest = np.sin(q), 1.0 - np.cos(q)
        for i in range(3):
            origins[body, i] = origins[parent, i] + step[i]
            for j in range(3):
                turn[i, j] = record.rotation[i, j] + sine * record.swing[i, j] + rest * record.bend[i, j]
        multiply(rotations[parent], turn, rotations[body])


@njit(cache=True)
def place_frame(frames: TreeFrames, k: int, rotations: Array, origins: Array, rotation: Array, position: Array) -> None:
    """Write the pose of frame k, (3, 3) and (3,) [m]; requires ``place_bodies``."""
    frame, step = frames[k], np.empty(3)
    body = frame.body
    multiply(rotations[body], frame.rotation, rotation)
    rotate(rotations[body], frame.translation, step)
    for i in range(3):
        position[i] = origins[body, i] + step[i]
