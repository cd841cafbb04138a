"""Fills the block of ``Terms`` in one compiled call; the numbers here say where its parts are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.memory import part_1, part_2, part_3
from controllers.qp.kernels_terms import centroidal_terms, frame_terms, quaternion_matrix
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

TERMS = (
    "q",
    "v",
    "base_rotation",
    "com",
    "com_velocity",
    "com_jacobian",
    "com_drift",
    "momentum",
    "momentum_matrix",
    "momentum_drift",
    "pose",
    "jacobian",
    "twist",
    "drift",
)
"""Parts of the block of ``Terms``; the last four hold left sole, right sole and torso."""

Q, V, BASE_ROTATION, COM, COM_VELOCITY, COM_JACOBIAN, COM_DRIFT = range(7)
MOMENTUM, MOMENTUM_MATRIX, MOMENTUM_DRIFT, POSE, JACOBIAN, TWIST, DRIFT = range(7, 14)


@njit(cache=True)
def read_terms(
    mass_matrix: Array,
    bias: Array,
    jacobian_world: Array,
    jacobian_rate_world: Array,
    rotation_1: Array,
    position_1: Array,
    rotation_2: Array,
    position_2: Array,
    rotation_3: Array,
    position_3: Array,
    columns_1: Index,
    columns_2: Index,
    columns_3: Index,
    mass: float,
    gravity: float,
    terms: Array,
    layout: Index,
) -> None:
    """Fill the block of ``Terms`` whose ``q`` and ``v`` Pinocchio has been called with.

    Args:
        mass_matrix: M (nv, nv) and h (nv,).
        bias: h (nv,).
        jacobian_world: ``data.J`` and ``data.dJ`` (6, nv).
        jacobian_rate_world: ``data.J`` and ``data.dJ`` (6, nv).
        rotation_1: Poses of the frames in W (3, 3), (3,).
        position_1: Poses of the frames in W (3, 3), (3,).
        rotation_2: Poses of the frames in W (3, 3), (3,).
        position_2: Poses of the frames in W (3, 3), (3,).
        rotation_3: Poses of the frames in W (3, 3), (3,).
        position_3: Poses of the frames in W (3, 3), (3,).
        columns_1: Columns of the joints that move each frame.
        columns_2: Columns of the joints that move each frame.
        columns_3: Columns of the joints that move each frame.
        mass: Total mass [kg].
        gravity: Magnitude [m/s^2].
        terms: In and out, block of ``Terms``.
        layout: Its layout.
    """
    q, v = part_1(terms, layout, Q), part_1(terms, layout, V)
    base_rotation = part_2(terms, layout, BASE_ROTATION)
    pose, jacobian = part_3(terms, layout, POSE), part_3(terms, layout, JACOBIAN)
    twist, drift = part_2(terms, layout, TWIST), part_2(terms, layout, DRIFT)
    quaternion_matrix(q[3:7], base_rotation)
    centroidal_terms(
        mass_matrix,
        bias,
        base_rotation,
        q[:3],
        v,
        mass,
        gravity,
        part_1(terms, layout, COM),
        part_1(terms, layout, COM_VELOCITY),
        part_2(terms, layout, COM_JACOBIAN),
        part_1(terms, layout, COM_DRIFT),
        part_1(terms, layout, MOMENTUM),
        part_2(terms, layout, MOMENTUM_MATRIX),
        part_1(terms, layout, MOMENTUM_DRIFT),
    )
    for i in range(3):
        for j in range(3):
            pose[0, i, j] = rotation_1[i, j]
            pose[1, i, j] = rotation_2[i, j]
            pose[2, i, j] = rotation_3[i, j]
        pose[0, i, 3] = position_1[i]
        pose[1, i, 3] = position_2[i]
        pose[2, i, 3] = position_3[i]
    for frame in range(3):
        columns = columns_1 if frame == 0 else columns_2 if frame == 1 else columns_3
        frame_terms(
            jacobian_world,
            jacobian_rate_world,
            columns,
            pose[frame],
            v,
            jacobian[frame],
            twist[frame],
            drift[frame],
        )
