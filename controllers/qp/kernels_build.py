"""The reduced QP: its cost as one compiled call, its rows as another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.memory import part_1, part_2, part_3
from controllers.qp.kernels_assemble import assemble_cost, assemble_rows
from controllers.qp.kernels_check import all_finite
from controllers.qp.kernels_feedback import (
    ACCELERATION_LOWER,
    ACCELERATION_UPPER,
    CONTACT_ACCELERATION,
    TORQUE,
    WRENCH_TARGET,
    WRENCH_WEIGHT,
    update_limits,
)
from controllers.qp.kernels_read import DRIFT, JACOBIAN
from controllers.qp.kernels_reduce import reduce_accelerations
from controllers.qp.kernels_stack import (
    POSTURE_TARGET,
    POSTURE_WEIGHT,
    TASK_JACOBIAN,
    TASK_TARGET,
    TASK_WEIGHT,
    stack_tasks,
)
from controllers.qp.kernels_wrenches import reduce_wrenches
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROBOT = ("cone", "cone_lower", "cone_upper", "row_scale")
"""Parts of the block of ``QPBuilder`` that never changes."""

REDUCTION = ("basis", "start", "inverse", "maps", "offsets", "hessian", "gradient", "matrix", "lower", "upper")
"""Parts of the block of one contact mode."""

CORE = 18
"""Velocities of the base and of two legs of six joints."""

CONE, CONE_LOWER, CONE_UPPER, _ROW_SCALE = range(4)
BASIS, START, _INVERSE, MAPS, OFFSETS, _HESSIAN, _GRADIENT, _MATRIX, _LOWER, _UPPER = range(10)


@njit(cache=True)
def fill_cost(
    mode: int,
    mass_matrix: Array,
    bias: Array,
    terms: Array,
    terms_layout: Index,
    indices: Index,
    plan: Index,
    com: Array,
    base: Array,
    torso: Array,
    heading_rate: float,
    sole_velocities: Array,
    sole_accelerations: Array,
    posture: Array,
    posture_velocity: Array,
    posture_acceleration: Array,
    stack: Array,
    stack_layout: Index,
    limits: Array,
    limits_layout: Index,
    sole_rotations: Array,
    sole_positions: Array,
    wrench_scale: float,
    pivot_floor: float,
    regularisation: float,
    reduction: Array,
    layout: Index,
) -> None:
    """Fill the cost of a contact mode's block from terms, stacked tasks and limits.

    Args:
        mode: Contact mode: 0 none, 1 first foot, 2 second foot, 3 both.
        mass_matrix: Dynamics (nv, nv), (nv,).
        bias: h (nv,).
        terms: Block of ``Terms``.
        terms_layout: Its layout.
        indices: Velocities of the base, of the first and of the second leg, then of the rest of the body (nv,).
        plan: See ``stack_tasks``, as all up to ``stack_layout``.
        com: (3,).
        base: (3, 3).
        torso: (3, 3).
        heading_rate: [rad/s].
        sole_velocities: (2, 6).
        sole_accelerations: (2, 6).
        posture: (nj,).
        posture_velocity: (nj,).
        posture_acceleration: (nj,).
        stack: Block with the parts ``STACK``.
        stack_layout: Its layout.
        limits: Block of ``QPLimits``.
        limits_layout: Its layout.
        sole_rotations: Rotation of each foothold in W (2, 3, 3).
        sole_positions: Position of each foothold in W (2, 3) [m].
        wrench_scale: See ``reduce_wrenches`` and ``null_space``.
        pivot_floor: See ``reduce_wrenches`` and ``null_space``.
        regularisation: Added to the diagonal of H.
        reduction: Out, block of the contact mode with the parts ``REDUCTION``.
        layout: Its layout.
    """
    stack_tasks(
        plan,
        terms,
        terms_layout,
        com,
        base,
        torso,
        heading_rate,
        sole_rotations,
        sole_positions,
        sole_velocities,
        sole_accelerations,
        posture,
        posture_velocity,
        posture_acceleration,
        stack,
        stack_layout,
    )
    update_limits(sole_rotations, sole_positions, terms, terms_layout, limits, limits_layout)
    jacobian, drift = part_3(terms, terms_layout, JACOBIAN), part_2(terms, terms_layout, DRIFT)
    core, leg_1, leg_2, upper = indices[:CORE], indices[6:12], indices[12:CORE], indices[CORE:]
    basis, start = part_2(reduction, layout, BASIS), part_1(reduction, layout, START)
    maps, offsets = part_3(reduction, layout, MAPS), part_2(reduction, layout, OFFSETS)
    inverse = part_3(reduction, layout, _INVERSE)
    hessian, gradient = part_2(reduction, layout, _HESSIAN), part_1(reduction, layout, _GRADIENT)
    contact_acceleration = part_2(limits, limits_layout, CONTACT_ACCELERATION)
    wanted = np.empty((2, 6))
    for foot in range(2):
        for i in range(6):
            wanted[foot, i] = contact_acceleration[foot, i] - drift[foot, i]
    reduce_accelerations(
        mode,
        mass_matrix,
        bias,
        jacobian[0],
        jacobian[1],
        inverse[0],
        inverse[1],
        wanted[0],
        wanted[1],
        upper,
        leg_1,
        leg_2,
        pivot_floor,
        basis,
        start,
    )
    reduce_wrenches(
        mode, mass_matrix, bias, inverse[0], inverse[1], upper, core, basis, start, wrench_scale, maps, offsets
    )
    assemble_cost(
        mode,
        part_2(stack, stack_layout, TASK_JACOBIAN),
        part_1(stack, stack_layout, TASK_TARGET),
        part_1(stack, stack_layout, TASK_WEIGHT),
        part_1(stack, stack_layout, POSTURE_TARGET),
        part_1(stack, stack_layout, POSTURE_WEIGHT),
        upper,
        core,
        basis,
        start,
        maps,
        offsets,
        part_2(limits, limits_layout, WRENCH_TARGET),
        part_2(limits, limits_layout, WRENCH_WEIGHT),
        regularisation,
        hessian,
        gradient,
    )


@njit(cache=True)
def fill_rows(
    mode: int,
    mass_matrix: Array,
    bias: Array,
    terms: Array,
    terms_layout: Index,
    indices: Index,
    robot: Array,
    robot_layout: Index,
    limits: Array,
    limits_layout: Index,
    reduction: Array,
    layout: Index,
) -> bool:
    """Fill the rows of a contact mode's block, after ``fill_cost`` and with the same arguments.

    Args:
        mode: Contact mode: 0 none, 1 first foot, 2 second foot, 3 both.
        mass_matrix: See ``fill_cost``, as all that have the same name.
        bias: h (nv,).
        terms: Block of ``Terms``.
        terms_layout: Its layout.
        indices: (nv,).
        robot: Block with the parts ``ROBOT``.
        robot_layout: Its layout.
        limits: Block of ``QPLimits``.
        limits_layout: Its layout.
        reduction: In and out, block of the contact mode.
        layout: Its layout.

    Returns:
        Whether cost and rows hold neither NaN nor infinity, and the bounds no NaN.
    """
    jacobian = part_3(terms, terms_layout, JACOBIAN)
    core, leg_1, leg_2, upper = indices[:CORE], indices[6:12], indices[12:CORE], indices[CORE:]
    basis, start = part_2(reduction, layout, BASIS), part_1(reduction, layout, START)
    maps, offsets = part_3(reduction, layout, MAPS), part_2(reduction, layout, OFFSETS)
    hessian, gradient = part_2(reduction, layout, _HESSIAN), part_1(reduction, layout, _GRADIENT)
    matrix = part_2(reduction, layout, _MATRIX)
    lower, upper_bound = part_1(reduction, layout, _LOWER), part_1(reduction, layout, _UPPER)
    assemble_rows(
        mode,
        mass_matrix,
        bias,
        jacobian[0],
        jacobian[1],
        upper,
        core,
        leg_1,
        leg_2,
        basis,
        start,
        maps,
        offsets,
        part_3(robot, robot_layout, CONE),
        part_2(robot, robot_layout, CONE_LOWER),
        part_2(robot, robot_layout, CONE_UPPER),
        part_1(limits, limits_layout, TORQUE),
        part_1(limits, limits_layout, ACCELERATION_LOWER),
        part_1(limits, limits_layout, ACCELERATION_UPPER),
        part_1(robot, robot_layout, _ROW_SCALE),
        matrix,
        lower,
        upper_bound,
    )
    for i in range(lower.shape[0]):  # bounds may be infinite
        if np.isnan(lower[i]) or np.isnan(upper_bound[i]):
            return False
    return all_finite(hessian, gradient, matrix)
