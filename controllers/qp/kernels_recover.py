"""What a solution of the reduced QP means: accelerations, wrenches, set-point, and whether they keep every limit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.memory import part_1, part_2, part_3
from controllers.qp.kernels_build import BASIS, CONE, CONE_LOWER, CONE_UPPER, MAPS, OFFSETS, START
from controllers.qp.kernels_feedback import (
    ACCELERATION_LOWER,
    ACCELERATION_UPPER,
    Q_MAX,
    Q_MIN,
    TORQUE,
    integrate_joints,
)
from controllers.qp.kernels_read import JACOBIAN, Q, V
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@njit(cache=True, fastmath={"reassoc", "contract"})
def recover(
    mode: int,
    z: Array,
    mass_matrix: Array,
    bias: Array,
    terms: Array,
    terms_layout: Index,
    robot: Array,
    robot_layout: Index,
    reduction: Array,
    layout: Index,
    limits: Array,
    limits_layout: Index,
    ahead: float,
    acceleration: Array,
    wrenches: Array,
    command: Array,
) -> bool:
    """Accelerations, wrenches and set-point of a solution z, with torques ``M_j a + h_j - sum J_ij' w_i``.

    Args:
        mode: Contact mode: 0 none, 1 first foot, 2 second foot, 3 both.
        z: Solution (nz,).
        mass_matrix: Dynamics.
        bias: h (nv,).
        terms: Block of ``Terms``.
        terms_layout: Its layout.
        robot: Block with the parts ``ROBOT``.
        robot_layout: Its layout.
        reduction: Block of the contact mode.
        layout: Its layout.
        limits: Block of ``QPLimits``.
        limits_layout: Its layout.
        ahead: Time over which the accelerations are integrated [s].
        acceleration: Out (nv,).
        wrenches: Out (2, 6).
        command: Out, joint positions, velocities and torques (3, nj).

    Returns:
        Whether they keep every limit: those that ``fill_rows`` writes as rows of z.
    """
    jacobian = part_3(terms, terms_layout, JACOBIAN)
    basis, start = part_2(reduction, layout, BASIS), part_1(reduction, layout, START)
    maps, offsets = part_3(reduction, layout, MAPS), part_2(reduction, layout, OFFSETS)
    q, v = part_1(terms, terms_layout, Q), part_1(terms, terms_layout, V)
    torque = command[2]
    nv, na = basis.shape
    nz = z.shape[0]
    for i in range(nv):
        total = start[i]
        for c in range(na):
            total += basis[i, c] * z[c]
        acceleration[i] = total
    for foot in range(2):
        for i in range(6):
            total = offsets[foot, i]
            for c in range(nz):
                total += maps[foot, i, c] * z[c]
            wrenches[foot, i] = total
    for j in range(nv - 6):
        torque[j] = bias[6 + j]
    for k in range(nv):
        for j in range(nv - 6):
            torque[j] += acceleration[k] * mass_matrix[k, 6 + j]
    for foot in range(2):
        for i in range(6):
            for j in range(nv - 6):
                torque[j] -= wrenches[foot, i] * jacobian[foot, i, 6 + j]
    integrate_joints(
        q[7:],
        v[6:],
        acceleration[6:],
        ahead,
        part_1(limits, limits_layout, Q_MIN),
        part_1(limits, limits_layout, Q_MAX),
        command[0],
        command[1],
    )
    return _within(
        mode,
        acceleration,
        wrenches,
        torque,
        part_3(robot, robot_layout, CONE),
        part_2(robot, robot_layout, CONE_LOWER),
        part_2(robot, robot_layout, CONE_UPPER),
        part_1(limits, limits_layout, TORQUE),
        part_1(limits, limits_layout, ACCELERATION_LOWER),
        part_1(limits, limits_layout, ACCELERATION_UPPER),
    )


@njit(cache=True)
def _within(
    mode: int,
    acceleration: Array,
    wrenches: Array,
    torque: Array,
    cone: Array,
    cone_lower: Array,
    cone_upper: Array,
    torque_max: Array,
    lower: Array,
    upper: Array,
) -> bool:
    """Whether joint accelerations and torques and the wrenches of the feet in contact keep their limits; NaN does not.

    Args:
        mode: Contact mode.
        acceleration: (nv,).
        wrenches: In the sole frames (2, 6).
        torque: (nj,).
        cone: Wrench cone of each foot (2, rows, 6), scaled.
        cone_lower: Its bounds (2, rows).
        cone_upper: Its bounds (2, rows).
        torque_max: (nj,).
        lower: Of the joint accelerations (nj,).
        upper: Likewise.
    """
    for j in range(torque.shape[0]):
        if not (abs(torque[j]) <= torque_max[j] and lower[j] <= acceleration[6 + j] <= upper[j]):
            return False
    for foot in range(2):
        if mode != 3 and mode != foot + 1:
            continue
        for i in range(cone.shape[1]):
            total = 0.0
            for k in range(6):
                total += cone[foot, i, k] * wrenches[foot, k]
            if not cone_lower[foot, i] <= total <= cone_upper[foot, i]:
                return False
    return True
