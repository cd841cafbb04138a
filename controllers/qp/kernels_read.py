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
    "offset",
)
"""Parts of the block of ``Terms``; the last five hold left sole, right sole and torso."""

Q, V, BASE_ROTATION, COM, COM_VELOCITY, COM_JACOBIAN, COM_DRIFT = range(7)
MOMENTUM, MOMENTUM_MATRIX, MOMENTUM_DRIFT, POSE, JACOBIAN, TWIST, DRIFT, OFFSET = range(7, 15)


@njit(cache=True)
def read_terms(
    mass_matrix: Array,
    bias: Array,
    jacobian_world: Array,
    rotation_1: Array,
    position_1: Array,
    linear_1: Array,
    angular_1: Array,
    rotation_2: Array,
    position_2: Array,
    linear_2: Array,
    angular_2: Array,
    rotation_3: Array,
    position_3: Array,
    linear_3: Array,
    angular_3: Array,
    columns: Index,
    mass: float,
    gravity: float,
    terms: Array,
    layout: Index,
) -> None:
    """Fill the block of ``Terms`` whose ``q`` and ``v`` Pinocchio has been called with.

    Args:
        mass_matrix: M (nv, nv).
        bias: h (nv,).
        jacobian_world: ``data.J`` (6, nv).
        rotation_1: Rotation of the left sole in W (3, 3).
        position_1: Its origin in W (3,).
        linear_1: Linear part of the acceleration of its joint, see ``frame_terms`` (3,).
        angular_1: Angular part (3,).
        rotation_2: The same of the right sole.
        position_2: The same of the right sole.
        linear_2: The same of the right sole.
        angular_2: The same of the right sole.
        rotation_3: The same of the torso.
        position_3: The same of the torso.
        linear_3: The same of the torso.
        angular_3: The same of the torso.
        columns: Columns of the joints that move each frame, filled up with -1 (3, k).
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
    offset = part_3(terms, layout, OFFSET)
    for frame in range(3):
        if frame == 0:
            rotation, position, linear, angular = rotation_1, position_1, linear_1, angular_1
        elif frame == 1:
            rotation, position, linear, angular = rotation_2, position_2, linear_2, angular_2
        else:
            rotation, position, linear, angular = rotation_3, position_3, linear_3, angular_3
        frame_terms(
            jacobian_world,
            columns[frame],
            rotation,
            position,
            offset[frame],
            linear,
            angular,
            gravity,
            v,
            pose[frame],
            jacobian[frame],
            twist[frame],
            drift[frame],
        )
