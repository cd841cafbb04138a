"""Rows of all tasks of the stack in one compiled pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.memory import part_1, part_2, part_3
from controllers.qp.kernels_feedback import orientation_feedback, pose_error, proportional_derivative
from controllers.qp.kernels_read import (
    BASE_ROTATION,
    COM_DRIFT,
    COM_JACOBIAN,
    DRIFT,
    JACOBIAN,
    MOMENTUM,
    MOMENTUM_DRIFT,
    MOMENTUM_MATRIX,
    POSE,
    TWIST,
    Q,
    V,
)
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STACK = (
    "jacobian",
    "target",
    "weight",
    "kp",
    "kd",
    "full_weight",
    "posture_target",
    "posture_kp",
    "posture_kd",
    "posture_weight",
)
"""Parts of the block of stacked tasks: (m, nv), five of (m,) with the weight in force and that of an active task, then
four of (nj,)."""

TASK_JACOBIAN, TASK_TARGET, TASK_WEIGHT, _KP, _KD, _FULL_WEIGHT, POSTURE_TARGET = range(7)
_POSTURE_KP, _POSTURE_KD, POSTURE_WEIGHT = range(7, 10)

PLAN = ("kind", "which", "first", "active")
"""Columns of the table of tasks: what it is, base or torso or which foot, its first row, whether it is active."""

_KIND, _WHICH, _FIRST, ACTIVE = range(4)

PYTHON_TASK, COM_TASK, MOMENTUM_TASK, ORIENTATION_TASK, FOOT_TASK = range(5)
"""Kinds of tasks; the rows of the first are written by its own ``stack``."""

BASE, TORSO = range(2)
"""Which orientation."""


@njit(cache=True)
def stack_tasks(
    plan: Index,
    terms: Array,
    terms_layout: Index,
    com: Array,
    base: Array,
    torso: Array,
    heading_rate: float,
    rotations: Array,
    positions: Array,
    velocities: Array,
    accelerations: Array,
    posture: Array,
    posture_velocity: Array,
    posture_acceleration: Array,
    stack: Array,
    layout: Index,
) -> None:
    """Jacobians and wanted accelerations less drifts of the active tasks, and the wanted joint accelerations.

    Args:
        plan: Table with the columns ``PLAN``, one row a task, in the order of their rows.
        terms: Block of ``Terms``.
        terms_layout: Its layout.
        com: Wanted CoM acceleration in W (3,) [m/s^2].
        base: Wanted orientation of the base in W (3, 3).
        torso: That of the torso (3, 3).
        heading_rate: Wanted turn of both about the vertical [rad/s].
        rotations: Wanted rotation of each sole in W (2, 3, 3).
        positions: Its place (2, 3) [m].
        velocities: Its twist in W (2, 6).
        accelerations: Its acceleration in W (2, 6).
        posture: Wanted joints (nj,) [rad].
        posture_velocity: (nj,) [rad/s].
        posture_acceleration: (nj,) [rad/s^2].
        stack: In and out, block with the parts ``STACK``.
        layout: Its layout.
    """
    jacobian, target = part_2(stack, layout, TASK_JACOBIAN), part_1(stack, layout, TASK_TARGET)
    weight, full = part_1(stack, layout, TASK_WEIGHT), part_1(stack, layout, _FULL_WEIGHT)
    kp, kd = part_1(stack, layout, _KP), part_1(stack, layout, _KD)
    for task in range(plan.shape[0]):
        kind, which, first = plan[task, _KIND], plan[task, _WHICH], plan[task, _FIRST]
        last = plan[task + 1, _FIRST] if task + 1 < plan.shape[0] else target.shape[0]
        if not plan[task, ACTIVE]:
            weight[first:last] = 0.0
            continue
        weight[first:last] = full[first:last]
        rows, out = jacobian[first:last], target[first:last]
        if kind == COM_TASK:
            com_rows(terms, terms_layout, com, rows, out)
        elif kind == MOMENTUM_TASK:
            momentum_rows(terms, terms_layout, kd[first:last], rows, out)
        elif kind == ORIENTATION_TASK:
            wanted = base if which == BASE else torso
            orientation_rows(
                which == BASE, terms, terms_layout, wanted, heading_rate, kp[first:last], kd[first:last], rows, out
            )
        elif kind == FOOT_TASK:
            foot_rows(
                terms,
                terms_layout,
                which,
                rotations[which],
                positions[which],
                velocities[which],
                accelerations[which],
                kp[first:last],
                kd[first:last],
                rows,
                out,
            )
    proportional_derivative(
        posture_acceleration,
        part_1(stack, layout, _POSTURE_KP),
        posture,
        part_1(terms, terms_layout, Q)[7:],
        part_1(stack, layout, _POSTURE_KD),
        posture_velocity,
        part_1(terms, terms_layout, V)[6:],
        part_1(stack, layout, POSTURE_TARGET),
    )


@njit(cache=True)
def com_rows(terms: Array, layout: Index, wanted: Array, jacobian: Array, target: Array) -> None:
    """Jacobian and wanted acceleration less drift of the CoM.

    Args:
        terms: Block of ``Terms``.
        layout: Its layout.
        wanted: Wanted acceleration in W (3,).
        jacobian: Out (3, nv).
        target: Out (3,).
    """
    source, drift = part_2(terms, layout, COM_JACOBIAN), part_1(terms, layout, COM_DRIFT)
    for i in range(3):
        target[i] = wanted[i] - drift[i]
        for j in range(source.shape[1]):
            jacobian[i, j] = source[i, j]


@njit(cache=True)
def momentum_rows(terms: Array, layout: Index, kd: Array, jacobian: Array, target: Array) -> None:
    """Centroidal map and wanted rate less drift of the angular momentum.

    Args:
        terms: Block of ``Terms``.
        layout: Its layout.
        kd: Damping (3,).
        jacobian: Out (3, nv).
        target: Out (3,).
    """
    source = part_2(terms, layout, MOMENTUM_MATRIX)
    momentum, drift = part_1(terms, layout, MOMENTUM), part_1(terms, layout, MOMENTUM_DRIFT)
    for i in range(3):
        target[i] = kd[i] * -momentum[i] - drift[i]
        for j in range(source.shape[1]):
            jacobian[i, j] = source[i, j]


@njit(cache=True)
def orientation_rows(
    is_base: bool,
    terms: Array,
    layout: Index,
    wanted: Array,
    heading_rate: float,
    kp: Array,
    kd: Array,
    jacobian: Array,
    target: Array,
) -> None:
    """Jacobian and wanted angular acceleration less drift of the base's or the torso's orientation.

    Args:
        is_base: Base, else torso.
        terms: Block of ``Terms``.
        layout: Its layout.
        wanted: R_ref (3, 3).
        heading_rate: Wanted turn about the vertical [rad/s].
        kp: Gains (3,).
        kd: Gains (3,).
        jacobian: Out (3, nv).
        target: Out (3,).
    """
    error = np.empty(3)
    if is_base:
        rotation, rate = part_2(terms, layout, BASE_ROTATION), part_1(terms, layout, V)[3:6]
        orientation_feedback(rotation, wanted, rate, kp, kd, error, target)
        jacobian[:, :] = 0.0
        for i in range(3):
            jacobian[i, 3 + i] = 1.0
    else:
        rotation, rate = part_3(terms, layout, POSE)[2], part_2(terms, layout, TWIST)[2, 3:]
        orientation_feedback(rotation, wanted, rate, kp, kd, error, target)
        drift, source = part_2(terms, layout, DRIFT)[2], part_3(terms, layout, JACOBIAN)[2]
        for i in range(3):
            target[i] -= drift[3 + i]
            for j in range(source.shape[1]):
                jacobian[i, j] = source[3 + i, j]
    if heading_rate != 0.0:
        for i in range(3):
            target[i] += kd[i] * heading_rate * rotation[2, i]


@njit(cache=True)
def foot_rows(
    terms: Array,
    layout: Index,
    foot: int,
    rotation: Array,
    position: Array,
    velocity: Array,
    acceleration: Array,
    kp: Array,
    kd: Array,
    jacobian: Array,
    target: Array,
) -> None:
    """Jacobian and wanted acceleration less drift of a swing foot, in its sole frame.

    Args:
        terms: Block of ``Terms``.
        layout: Its layout.
        foot: Which one.
        rotation: Wanted rotation in W (3, 3).
        position: Wanted place in W (3,).
        velocity: Wanted twist in W (6,).
        acceleration: Feed-forward in W (6,).
        kp: Gains (6,).
        kd: Gains (6,).
        jacobian: Out (6, nv).
        target: Out (6,).
    """
    pose, twist = part_3(terms, layout, POSE)[foot], part_2(terms, layout, TWIST)[foot]
    drift, source = part_2(terms, layout, DRIFT)[foot], part_3(terms, layout, JACOBIAN)[foot]
    error = np.empty(6)
    pose_error(pose, rotation, position, error)
    foot_feedback(pose, velocity, acceleration, error, twist, kp, kd, target)
    for i in range(6):
        target[i] -= drift[i]
        for j in range(source.shape[1]):
            jacobian[i, j] = source[i, j]


@njit(cache=True)
def foot_feedback(
    pose: Array,
    velocity: Array,
    acceleration: Array,
    error: Array,
    twist: Array,
    kp: Array,
    kd: Array,
    out: Array,
) -> None:
    """Wanted acceleration in the sole frame (6,), from the wanted motion in W and error and twist in the sole frame."""
    for part in range(0, 6, 3):
        for i in range(3):
            v, a = 0.0, 0.0
            for k in range(3):
                v += pose[k, i] * velocity[part + k]
                a += pose[k, i] * acceleration[part + k]
            row = part + i
            out[row] = a + kp[row] * error[row] + kd[row] * (v - twist[row])
