"""Compiled generalised momentum of the whole robot and the known part of its rate, in two sweeps over the tree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.so3 import multiply, rotate, rotate_transposed
from controllers.kernels_posture import TREE
from controllers.memory import part_1, part_2, part_3
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BODIES = ("masses", "inertias", "axes", "armature", "damping", "friction")
"""Parts of the block of bodies and joints: mass and inertia about the CoM of each body, joint axis and drive."""

SWEEP = (
    "rotations", "origins", "joint_axes", "linear", "angular", "momentum", "moment", "gravity",
    "joint_momentum", "joint_rate", "centroid", "sole_rotations", "sole_positions",
)  # fmt: skip
"""Parts of the block of results; ``generalised_momentum`` has their meaning."""

_MASSES, _INERTIAS, _AXES, _ARMATURE = range(4)
_TREE_ROTATIONS, _SWINGS, _BENDS, _TRANSLATIONS, _, _LEVERS, _FRAME_ROTATIONS, _FRAME_TRANSLATIONS = range(len(TREE))
(
    ROTATIONS, ORIGINS, JOINT_AXES, LINEAR, ANGULAR, MOMENTUM, MOMENT, GRAVITY_WRENCH,
    JOINT_MOMENTUM, JOINT_RATE, CENTROID, SOLE_ROTATIONS, SOLE_POSITIONS,
) = range(13)  # fmt: skip


@njit(cache=True)
def _cross(a: Array, b: Array, out: Array) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@njit(cache=True)
def generalised_momentum(
    q: Array, v: Array, gravity: float, tree: Array, tree_layout: Index, parents: Index, feet: Index,
    bodies: Array, bodies_layout: Index, sweep: Array, layout: Index,
) -> None:  # fmt: skip
    """Momentum of every subtree, and from it p = M v and the part of p' that is not a joint torque.

    Everything is world-aligned and about the origin of the base. With S_n the motion subspace of joint n, V_n the
    spatial velocity of its body, h_n the momentum of all it carries and G_n the weight of that::

        p_n = S_n . h_n + I_n dq_n,      p_n' = S_n . (transmitted force) + (V_n x S_n) . h_n + S_n . G_n

    so ``joint_rate`` = (V_n x S_n) . h_n + S_n . G_n is row n of C' v - g, without the Coriolis matrix.

    Args:
        q: Configuration (nq,).
        v: Velocity, base twist in B first (nv,).
        gravity: [m/s^2].
        tree: Kinematic tree of ``PostureReference``.
        tree_layout: Its layout.
        parents: Parent body of each joint (nj,); body 0 is the base.
        feet: Body that carries each sole (>= 2,).
        bodies: Block of ``BODIES``.
        bodies_layout: Its layout.
        sweep: Out, block of ``SWEEP``: rotation of each body in W; origin of each body; axis of each joint (by body,
            the base's unused); linear and angular velocity of each body at the base's origin; linear momentum,
            angular momentum and (mass, first moment of mass) of each subtree; p and its known rate of each joint;
            CoM relative to the base, CoM velocity, angular momentum about the CoM (3, 3); rotation and origin of both
            soles. Origins are relative to the base's.
        layout: Its layout.
    """
    placements, levers = part_3(tree, tree_layout, _TREE_ROTATIONS), part_2(tree, tree_layout, _LEVERS)
    swings, bends = part_3(tree, tree_layout, _SWINGS), part_3(tree, tree_layout, _BENDS)
    shifts = part_2(tree, tree_layout, _TRANSLATIONS)
    frame_rotations = part_3(tree, tree_layout, _FRAME_ROTATIONS)
    frame_translations = part_2(tree, tree_layout, _FRAME_TRANSLATIONS)
    masses, inertias = part_1(bodies, bodies_layout, _MASSES), part_3(bodies, bodies_layout, _INERTIAS)
    local_axes, armature = part_2(bodies, bodies_layout, _AXES), part_1(bodies, bodies_layout, _ARMATURE)
    rotations, origins = part_3(sweep, layout, ROTATIONS), part_2(sweep, layout, ORIGINS)
    axes = part_2(sweep, layout, JOINT_AXES)
    linear, angular = part_2(sweep, layout, LINEAR), part_2(sweep, layout, ANGULAR)
    momentum, moment = part_2(sweep, layout, MOMENTUM), part_2(sweep, layout, MOMENT)
    weight = part_2(sweep, layout, GRAVITY_WRENCH)
    joint_momentum, joint_rate = part_1(sweep, layout, JOINT_MOMENTUM), part_1(sweep, layout, JOINT_RATE)
    count = parents.shape[0]
    turn, work, lever, local = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)

    x, y, z, w = q[3], q[4], q[5], q[6]
    base = rotations[0]
    base[0, 0], base[0, 1], base[0, 2] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)
    base[1, 0], base[1, 1], base[1, 2] = 2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)
    base[2, 0], base[2, 1], base[2, 2] = 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)
    rotate(base, v[0:3], linear[0])
    rotate(base, v[3:6], angular[0])
    for body in range(count + 1):
        if body > 0:
            n = body - 1
            parent = parents[n]
            rotate(rotations[parent], shifts[n], work)
            sine, rest = np.sin(q[7 + n]), 1.0 - np.cos(q[7 + n])
            for i in range(3):
                origins[body, i] = origins[parent, i] + work[i]
                for j in range(3):
                    turn[i, j] = placements[n, i, j] + sine * swings[n, i, j] + rest * bends[n, i, j]
            multiply(rotations[parent], turn, rotations[body])
            rotate(rotations[body], local_axes[n], axes[body])
            _cross(origins[body], axes[body], work)
            for i in range(3):
                linear[body, i] = linear[parent, i] + v[6 + n] * work[i]
                angular[body, i] = angular[parent, i] + v[6 + n] * axes[body, i]
        rotate(rotations[body], levers[body], lever)
        for i in range(3):
            lever[i] += origins[body, i]
        _cross(angular[body], lever, work)
        mass = masses[body]
        weight[body, 0] = mass
        for i in range(3):
            momentum[body, i] = mass * (linear[body, i] + work[i])
            weight[body, 1 + i] = mass * lever[i]
        _cross(lever, momentum[body], moment[body])
        rotate_transposed(rotations[body], angular[body], work)
        rotate(inertias[body], work, local)
        rotate(rotations[body], local, work)
        for i in range(3):
            moment[body, i] += work[i]
    for body in range(count, 0, -1):
        parent = parents[body - 1]
        for i in range(3):
            momentum[parent, i] += momentum[body, i]
            moment[parent, i] += moment[body, i]
        for i in range(4):
            weight[parent, i] += weight[body, i]
        axis = axes[body]
        _cross(origins[body], axis, lever)  # linear part of S
        _cross(angular[body], lever, work)
        _cross(linear[body], axis, local)
        total, rate = 0.0, 0.0
        for i in range(3):
            total += lever[i] * momentum[body, i] + axis[i] * moment[body, i]
            rate += (work[i] + local[i]) * momentum[body, i]
        _cross(angular[body], axis, work)
        for i in range(3):
            rate += work[i] * moment[body, i]
        # Weight (0, 0, -m g) at the subtree's CoM c: its moment is m g (-c_y, c_x, 0).
        rate += gravity * (axis[1] * weight[body, 1] - axis[0] * weight[body, 2] - lever[2] * weight[body, 0])
        joint_momentum[body - 1] = total + armature[body - 1] * v[5 + body]
        joint_rate[body - 1] = rate
    centroid = part_2(sweep, layout, CENTROID)
    for i in range(3):
        centroid[0, i] = weight[0, 1 + i] / weight[0, 0]
        centroid[1, i] = momentum[0, i] / weight[0, 0]
    _cross(centroid[0], momentum[0], work)
    for i in range(3):
        centroid[2, i] = moment[0, i] - work[i]
    sole_rotations, sole_positions = part_3(sweep, layout, SOLE_ROTATIONS), part_2(sweep, layout, SOLE_POSITIONS)
    for foot in range(2):
        body = feet[foot]
        multiply(rotations[body], frame_rotations[foot], sole_rotations[foot])
        rotate(rotations[body], frame_translations[foot], work)
        for i in range(3):
            sole_positions[foot, i] = origins[body, i] + work[i]
