"""Converts joint positions into whole-body references for a robot with planted soles."""

import numpy as np
from numpy.typing import NDArray

from models.numerics.compiled import njit
from models.numerics.so3 import exponential, multiply, rotate, rotation_error
from models.robot_model import RobotModel
from models.tree import KinematicTree, TreeFrames, place_bodies, place_frame, read_frames

Array = NDArray[np.float64]


def posture_frames(model: RobotModel) -> TreeFrames:
    """Frames of left sole, right sole and torso, for ``posture_reference``."""
    return read_frames(model.pin, (*(foot.frame_id for foot in model.feet), model.frame_id("torso")))


@njit(cache=True)
def posture_reference(
    joints: Array, tree: KinematicTree, frames: TreeFrames, com: Array, base: Array, torso: Array
) -> None:
    """Compute CoM and orientations of a posture (nj,) [rad] in the anchor frame, half-way between its soles.

    The pose of the anchor in the base frame is the midpoint ``p_mid`` and ``R_mid = R_L exp(log(R_L' R_R) / 2)``. Out:
    ``com = R_mid' (c - p_mid)`` (3,) [m], ``base = R_mid'`` (3, 3), ``torso = R_mid' R_T`` (3, 3).
    """
    count = joints.shape[0] + 1
    rotations, origins = np.zeros((count, 3, 3)), np.zeros((count, 3))
    placed, positions = np.zeros((3, 3, 3)), np.zeros((3, 3))
    turn, middle, step, centre = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.zeros(3)
    for i in range(3):
        rotations[0, i, i] = 1.0
    place_bodies(tree, joints, rotations, origins)
    total = 0.0
    for body in range(count):
        total += tree[body].mass
    for body in range(count):
        rotate(rotations[body], tree[body].lever, step)
        for i in range(3):
            centre[i] += tree[body].mass / total * (origins[body, i] + step[i])
    for k in range(3):
        place_frame(frames, k, rotations, origins, placed[k], positions[k])
    rotation_error(placed[0], placed[1], step)
    for i in range(3):
        step[i] *= 0.5
    exponential(step, turn)
    multiply(placed[0], turn, middle)
    for i in range(3):
        com[i] = 0.0
        for k in range(3):
            com[i] += middle[k, i] * (centre[k] - 0.5 * (positions[0, k] + positions[1, k]))
            base[i, k] = middle[k, i]
        for j in range(3):
            torso[i, j] = (
                middle[0, i] * placed[2, 0, j] + middle[1, i] * placed[2, 1, j] + middle[2, i] * placed[2, 2, j]
            )
