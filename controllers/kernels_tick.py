"""The balance law's and the walking law's part of one tick, each as one compiled call."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.kernels_balance import balance_feedback, move_footholds, place_reference
from controllers.kernels_posture import posture_reference
from controllers.memory import part_1, part_2, part_3
from controllers.qp.kernels_read import COM, COM_VELOCITY, POSE
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BALANCE = (
    "corners",
    "gains",
    "rotations",
    "positions",
    "anchor_rotation",
    "anchor",
    "dcm",
    "cmp",
    "acceleration",
    "com",
    "base",
    "torso",
)
"""Parts of the block of ``BalanceController``; the last three are those of its ``PostureReference``."""

_CORNERS, _GAINS, _ROTATIONS, _POSITIONS, _ANCHOR_ROTATION, _ANCHOR = range(6)
_DCM, _CMP, _ACCELERATION, _POSTURE_COM, _POSTURE_BASE, _POSTURE_TORSO = range(6, 12)

WALKING = ("corners", "gains", "dcm", "cmp", "acceleration")
"""Parts of the block of ``WalkingController``."""

_REACH = 7
"""Which of its gains bounds the shift of the CMP [m]; the ones before are those of ``balance_feedback``."""

_WALKING_DCM, _WALKING_CMP, _WALKING_ACCELERATION = range(2, 5)


@njit(cache=True)
def balance_tick(
    joints: Array,
    moving: bool,
    fresh: bool,
    dt: float,
    wrench_left: Array,
    wrench_right: Array,
    least_load: float,
    share: float,
    gravity: float,
    terms: Array,
    terms_layout: Index,
    tree: Array,
    tree_layout: Index,
    parents: Index,
    bodies: Index,
    balance: Array,
    layout: Index,
    reference: Array,
) -> float:
    """Footholds, references and DCM feedback of ``BalanceController``.

    Args:
        joints: Posture reference (nj,) [rad].
        moving: Whether it has changed since the last tick.
        fresh: Whether this is the first tick.
        dt: Time since the last tick [s].
        wrench_left: Ground reaction on the left sole, in its frame (6,).
        wrench_right: On the right sole (6,).
        least_load: Normal force from which on a foot bears load; on the first tick both do [N].
        share: Share of the way that footholds go to the measured soles on this tick.
        gravity: [m/s^2].
        terms: Block of ``Terms``.
        terms_layout: Its layout.
        tree: See ``posture_reference``.
        tree_layout: Its layout.
        parents: See ``posture_reference``.
        bodies: See ``posture_reference``.
        balance: Block of ``BalanceController``.
        layout: Its layout.
        reference: Out, in W: CoM, its velocity, rotation of the base (3, 3) and of the torso (3, 3), one below the
            other (8, 3).

    Returns:
        Capture margin [m].
    """
    pose = part_3(terms, terms_layout, POSE)
    rotations, positions = part_3(balance, layout, _ROTATIONS), part_2(balance, layout, _POSITIONS)
    anchor_rotation, anchor = part_2(balance, layout, _ANCHOR_ROTATION), part_1(balance, layout, _ANCHOR)
    posture_com = part_1(balance, layout, _POSTURE_COM)
    posture_base, posture_torso = part_2(balance, layout, _POSTURE_BASE), part_2(balance, layout, _POSTURE_TORSO)
    velocity = np.zeros(3)
    if moving:
        before = posture_com.copy()
        posture_reference(joints, tree, tree_layout, parents, bodies, posture_com, posture_base, posture_torso)
        if not fresh:
            for i in range(3):
                velocity[i] = (posture_com[i] - before[i]) / dt
    move_footholds(
        pose[0],
        pose[1],
        fresh or wrench_left[2] > least_load,
        fresh or wrench_right[2] > least_load,
        share,
        rotations,
        positions,
        anchor_rotation,
        anchor,
    )
    com, com_velocity = reference[0], reference[1]
    place_reference(
        anchor_rotation,
        anchor,
        posture_com,
        velocity,
        posture_base,
        posture_torso,
        com,
        com_velocity,
        reference[2:5],
        reference[5:],
    )
    return balance_feedback(
        part_1(terms, terms_layout, COM),
        part_1(terms, terms_layout, COM_VELOCITY),
        com,
        com_velocity,
        anchor[2],
        gravity,
        pose[0],
        pose[1],
        part_3(balance, layout, _CORNERS),
        part_1(balance, layout, _GAINS),
        part_1(balance, layout, _DCM),
        part_1(balance, layout, _CMP),
        part_1(balance, layout, _ACCELERATION),
    )


@njit(cache=True)
def walking_tick(
    left: bool,
    right: bool,
    com: Array,
    com_velocity: Array,
    dcm: Array,
    dcm_velocity: Array,
    sole_positions: Array,
    shift: Array,
    gravity: float,
    terms: Array,
    terms_layout: Index,
    walking: Array,
    layout: Index,
) -> float:
    """DCM feedback of ``WalkingController``.

    Args:
        left: Whether the left foot is planned to bear load.
        right: Whether the right one is; both count where neither is.
        com: Wanted, in W (3,); its height counts.
        com_velocity: Wanted (3,); likewise.
        dcm: Wanted (2,).
        dcm_velocity: Wanted (2,).
        sole_positions: Footholds in W (2, 3).
        shift: Of the CMP, by the planned reaction of the swing leg in single support (2,) [m].
        gravity: [m/s^2].
        terms: Block of ``Terms``.
        terms_layout: Its layout.
        walking: Block with the parts ``WALKING``.
        layout: Its layout.

    Returns:
        Capture margin [m].
    """
    pose, measured = part_3(terms, terms_layout, POSE), part_1(terms, terms_layout, COM)
    soles, corners = pose[:2].copy(), part_3(walking, layout, _CORNERS).copy()
    if left == right:
        ground = 0.5 * (sole_positions[0, 2] + sole_positions[1, 2])
    else:
        stance = 0 if left else 1
        ground = sole_positions[stance, 2]
        # Where the stance sole would be for the CMP to be inside it just when the CoP is inside the real one.
        reach = part_1(walking, layout, _GAINS)[_REACH]
        for i in range(2):
            soles[stance, i, 3] += min(max(shift[i], -reach), reach)
        soles[1 - stance], corners[1 - stance] = soles[stance], corners[stance]
    omega = np.sqrt(gravity / max(measured[2] - ground, 0.1))
    # The feedback speaks of CoM references: this one has the wanted DCM and drift.
    position, velocity = com.copy(), com_velocity.copy()
    for i in range(2):
        velocity[i] = dcm_velocity[i]
        position[i] = dcm[i] - velocity[i] / omega
    return balance_feedback(
        measured,
        part_1(terms, terms_layout, COM_VELOCITY),
        position,
        velocity,
        ground,
        gravity,
        soles[0],
        soles[1],
        corners,
        part_1(walking, layout, _GAINS),
        part_1(walking, layout, _WALKING_DCM),
        part_1(walking, layout, _WALKING_CMP),
        part_1(walking, layout, _WALKING_ACCELERATION),
    )
