"""Compiled forward kinematics of a whole posture: CoM, soles and torso relative to the soles' mid-frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.so3 import exponential, multiply, rotate
from controllers.memory import part_1, part_2, part_3
from controllers.qp.kernels_terms import rotation_error
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TREE = ("rotations", "swings", "bends", "translations", "masses", "levers", "frame_rotations", "frame_translations")
"""Parts of the kinematic tree's block: a joint at q is ``rotations + sin q swings + (1 - cos q) bends`` turned."""

_ROTATIONS, _SWINGS, _BENDS, _TRANSLATIONS, _MASSES, _LEVERS, _FRAME_ROTATIONS, _FRAME_TRANSLATIONS = range(8)


@njit(cache=True)
def posture_reference(
    joints: Array, tree: Array, layout: Index, parents: Index, bodies: Index, com: Array, base: Array, torso: Array
) -> None:
    """CoM and orientations of a posture, seen from the mid-frame of its soles.

    With ``T_mid`` the frame half-way between the soles, ``R_mid = R_L exp(log(R_L' R_R) / 2)``, seen from the base::

        com = R_mid' (c - p_mid),    base = R_mid',    torso = R_mid' R_T

    Args:
        joints: Joint positions (nj,) [rad].
        tree: Block of ``PostureReference``; body 0 is the base, frames are left sole, right sole, torso.
        layout: Its layout.
        parents: Parent body of each joint (nj,).
        bodies: Body that carries each frame (3,).
        com: Out (3,) [m].
        base: Out (3, 3).
        torso: Out (3, 3).
    """
    placements, levers = part_3(tree, layout, _ROTATIONS), part_2(tree, layout, _LEVERS)
    swings, bends = part_3(tree, layout, _SWINGS), part_3(tree, layout, _BENDS)
    shifts = part_2(tree, layout, _TRANSLATIONS)
    masses = part_1(tree, layout, _MASSES)
    frame_rotations = part_3(tree, layout, _FRAME_ROTATIONS)
    frame_translations = part_2(tree, layout, _FRAME_TRANSLATIONS)
    count = joints.shape[0]
    rotations = np.zeros((count + 1, 3, 3))
    positions = np.zeros((count + 1, 3))
    turn, work = np.empty((3, 3)), np.empty((3, 3))
    step = np.empty(3)
    centre = np.zeros(3)
    for i in range(3):
        rotations[0, i, i] = 1.0
        centre[i] = masses[0] * levers[0, i]
    for n in range(count):
        parent = parents[n]
        rotate(rotations[parent], shifts[n], step)
        for i in range(3):
            positions[n + 1, i] = positions[parent, i] + step[i]
        sine, rest = np.sin(joints[n]), 1.0 - np.cos(joints[n])
        for i in range(3):
            for j in range(3):
                turn[i, j] = placements[n, i, j] + sine * swings[n, i, j] + rest * bends[n, i, j]
        multiply(rotations[parent], turn, rotations[n + 1])
        rotate(rotations[n + 1], levers[n + 1], step)
        for i in range(3):
            centre[i] += masses[n + 1] * (positions[n + 1, i] + step[i])
    frames = np.zeros((3, 3, 3))
    origins = np.zeros((3, 3))
    for f in range(3):
        body = bodies[f]
        multiply(rotations[body], frame_rotations[f], frames[f])
        rotate(rotations[body], frame_translations[f], step)
        for i in range(3):
            origins[f, i] = positions[body, i] + step[i]
    rotation_error(frames[0], frames[1], step)
    for i in range(3):
        step[i] *= 0.5
    exponential(step, turn)
    multiply(frames[0], turn, work)  # R_mid
    for i in range(3):
        com[i] = 0.0
        for k in range(3):
            com[i] += work[k, i] * (centre[k] - 0.5 * (origins[0, k] + origins[1, k]))
            base[i, k] = work[k, i]
        for j in range(3):
            torso[i, j] = work[0, i] * frames[2, 0, j] + work[1, i] * frames[2, 1, j] + work[2, i] * frames[2, 2, j]
