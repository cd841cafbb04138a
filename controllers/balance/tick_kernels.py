"""The balance law's parts of one tick, each as one compiled call."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.balance.kernels import balance_feedback, move_footholds, place_reference
from controllers.balance.posture_reference import posture_reference
from controllers.qp.memory import part_1, part_2, part_3
from controllers.qp.terms import follow_pose
from models.numerics.compiled import njit
from models.tree import KinematicTree, TreeFrames

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: Parts of the block of ``BalanceController``; the last three are those of its ``PostureReference``
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
_CORNERS, _GAINS, _ROTATIONS, _POSITIONS, _ANCHOR_ROTATION, _ANCHOR = range(6)
_DCM, _CMP, _ACCELERATION, _POSTURE_COM, _POSTURE_BASE, _POSTURE_TORSO = range(6, 12)

#: Index of the gain that bounds the shift of the CMP [m]; those before it are the gains of ``balance_feedback``
_REACH = 7


@njit(cache=True)
def standing_reference(
    joints: Array,
    moving: bool,
    fresh: bool,
    dt: float,
    wrench_left: Array,
    wrench_right: Array,
    least_load: float,
    share: float,
    pose: Array,
    tree: KinematicTree,
    frames: TreeFrames,
    balance: Array,
    layout: Index,
    reference: Array,
) -> None:
    """Footholds, and the references that a posture means on them.

    Args:
        joints: Posture reference (nj,) [rad].
        moving: Whether it has changed since the last tick.
        fresh: Whether this is the first tick.
        dt: Time since the last tick [s].
        wrench_left: Ground reaction on the left sole, in its frame (6,).
        wrench_right: On the right sole (6,).
        least_load: Normal force from which on a foot bears load; on the first tick both do [N].
        share: Share of the way that footholds go to the measured soles on this tick.
        pose: Measured poses of both soles, and of other frames (frames, 4, 4).
        tree: See ``posture_reference``.
        frames: See ``posture_reference``.
        balance: Block of ``BalanceController``.
        layout: Its layout.
        reference: Out, in W: CoM, its velocity, rotation of the base (3, 3) and of the torso (3, 3), one below the
            other (8, 3).
    """
    rotations, positions = part_3(balance, layout, _ROTATIONS), part_2(balance, layout, _POSITIONS)
    anchor_rotation, anchor = part_2(balance, layout, _ANCHOR_ROTATION), part_1(balance, layout, _ANCHOR)
    posture_com = part_1(balance, layout, _POSTURE_COM)
    posture_base, posture_torso = part_2(balance, layout, _POSTURE_BASE), part_2(balance, layout, _POSTURE_TORSO)
    velocity = np.zeros(3)
    if moving:
        before = posture_com.copy()
        posture_reference(joints, tree, frames, posture_com, posture_base, posture_torso)
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
    place_reference(
        anchor_rotation,
        anchor,
        posture_com,
        velocity,
        posture_base,
        posture_torso,
        reference[0],
        reference[1],
        reference[2:5],
        reference[5:],
    )


@njit(cache=True)
def feedback_tick(
    left: bool,
    right: bool,
    com: Array,
    com_velocity: Array,
    dcm: Array,
    dcm_velocity: Array,
    led: bool,
    sole_positions: Array,
    shift: Array,
    gravity: float,
    pose: Array,
    measured: Array,
    velocity_measured: Array,
    balance: Array,
    layout: Index,
) -> float:
    """DCM feedback of ``BalanceController``.

    Args:
        left: Whether the left foot is planned to bear load.
        right: Whether the right one is; both count where neither is.
        com: Desired, in W (3,).
        com_velocity: Desired, in W (3,).
        dcm: Desired (2,).
        dcm_velocity: Desired (2,).
        led: Whether these two replace the horizontal part of the CoM reference.
        sole_positions: Footholds in W (2, 3).
        shift: Of the CMP, by the planned reaction of the swing leg in single support (2,) [m].
        gravity: [m/s^2].
        pose: Measured poses of both soles, and of other frames (frames, 4, 4).
        measured: CoM in W (3,).
        velocity_measured: Its velocity in W (3,).
        balance: Block of ``BalanceController``.
        layout: Its layout.

    Returns:
        Capture margin [m].
    """
    soles, corners = pose[:2].copy(), part_3(balance, layout, _CORNERS).copy()
    if left == right:
        ground = 0.5 * (sole_positions[0, 2] + sole_positions[1, 2])
    else:
        stance = 0 if left else 1
        ground = sole_positions[stance, 2]
        # Where the stance sole would be for the CMP to be inside it just when the CoP is inside the real one.
        reach = part_1(balance, layout, _GAINS)[_REACH]
        for i in range(2):
            soles[stance, i, 3] += min(max(shift[i], -reach), reach)
        soles[1 - stance], corners[1 - stance] = soles[stance], corners[stance]
    omega = np.sqrt(gravity / max(measured[2] - ground, 0.1))
    position, velocity = com.copy(), com_velocity.copy()
    if led:  # the CoM reference that has this DCM and drift
        for i in range(2):
            velocity[i] = dcm_velocity[i]
            position[i] = dcm[i] - velocity[i] / omega
    return balance_feedback(
        measured,
        velocity_measured,
        position,
        velocity,
        ground,
        gravity,
        soles[0],
        soles[1],
        corners,
        part_1(balance, layout, _GAINS),
        part_1(balance, layout, _DCM),
        part_1(balance, layout, _CMP),
        part_1(balance, layout, _ACCELERATION),
    )


@njit(cache=True)
def blend_rotations(first: Array, second: Array, share: float, out: Array) -> None:
    """Rotations a share of the way from one set to another, along the shortest turns (n, 3, 3)."""
    pose, unused = np.eye(4), np.zeros(3)
    for k in range(first.shape[0]):
        out[k] = first[k]
        pose[:3, :3] = second[k]
        follow_pose(out[k], unused, pose, share)
