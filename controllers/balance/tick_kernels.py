"""Parts of one tick of the balance law, each compiled as one call."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.balance.posture_reference import posture_reference
from controllers.balance.support import cmp_command
from controllers.qp.contacts import Edges
from controllers.qp.terms import follow_pose
from controllers.whole_body.config import CoMGains, DcmFeedback
from models.constants import COM_HEIGHT_MIN, GRAVITY
from models.numerics.compiled import njit, register_jitable
from models.numerics.hull import convex_hull
from models.numerics.unboxed import Unboxed
from models.tree import KinematicTree, TreeFrames
from planners.gait.footsteps import Place, Point, common_motion, point_at, rotated

Array = NDArray[np.float64]

_STANCE = 0.005  #: Displacement of each sole from the 'stand' stance that does not lower the CoM [m]


class BalanceArrays(NamedTuple):
    """Arrays and measurements of ``BalanceController`` for compiled code; in W unless stated otherwise."""

    poses: Array  #: Measured poses of both soles and of other frames (frames, 4, 4)
    com: Array  #: Measured CoM (3,)
    com_velocity: Array  #: Measured velocity of the CoM (3,)
    tree: KinematicTree  #: See ``posture_reference``
    frames: TreeFrames  #: See ``posture_reference``
    edges: Edges  #: Free axes of soles that stand on an edge
    turning: NDArray[np.bool_]  #: Whether each planted sole turns with its leg about x and about y (2, 2)
    corners: Array  #: Corners of the support areas in the sole frames (2, 4, 3)
    gains: Array  #: Gains of ``feedback_gains``, then the largest shift of the CMP [m] (8,)
    rotations: Array  #: Rotations of the footholds (2, 3, 3)
    positions: Array  #: Positions of the footholds (2, 3)
    seen: Array  #: x, y [m], heading [rad] and height [m] of the soles in the last tick (2, 4)
    anchor_rotation: Array  #: See ``_move_footholds`` (3, 3)
    anchor: Array  #: See ``_move_footholds`` (3,)
    apart: Array  #: Vector from the right to the left sole in 'stand', in the anchor frame (3,)
    posture_com: Array  #: CoM of the last posture, in the anchor frame (3,)
    posture_base: Array  #: Base rotation of the last posture, in the anchor frame (3, 3)
    posture_torso: Array  #: Torso rotation of the last posture, in the anchor frame (3, 3)
    dcm: Array  #: Measured DCM (2,)
    cmp: Array  #: Commanded CMP (2,)
    acceleration: Array  #: Commanded acceleration of the CoM (3,)


def feedback_gains(config: DcmFeedback, height: CoMGains) -> tuple[float, ...]:
    """DCM gain, polygon margin, momentum margin, momentum gain, largest reach, height kp and kd (7,)."""
    momentum = config.momentum_margin, config.momentum_gain, config.momentum_reach_max
    return config.dcm_gain, config.polygon_margin, *momentum, height.kp, height.kd


@njit(cache=True)
def standing_reference(
    balance: Unboxed[BalanceArrays],
    joints: Array,
    moving: bool,
    fresh: bool,
    dt: float,
    wrench_left: Array,
    wrench_right: Array,
    least_load: float,
    share: float,
    leg: float,
    reference: Array,
) -> None:
    """Update the footholds and compute the references of a posture (nj,) on them.

    ``moving``: the posture has changed; ``fresh``: first tick. Footholds follow flat soles with a load above
    ``least_load`` [N], all soles if ``share`` (see ``_move_footholds``) is 1. ``leg`` is the leg length in 'stand' [m]:
    soles farther apart than in 'stand' lower the CoM; 0 disables this. Out: ``reference`` (9, 3), in W: CoM, its
    velocity, rotations of base and torso; then DCM and CoM height above the soles.
    """
    arrays, velocity = balance.record, np.zeros(3)
    if moving:
        before = arrays.posture_com.copy()
        posture_reference(
            joints, arrays.tree, arrays.frames, arrays.posture_com, arrays.posture_base, arrays.posture_torso
        )
        if not fresh:
            for i in range(3):
                velocity[i] = (arrays.posture_com[i] - before[i]) / dt
    loads = wrench_left[2], wrench_right[2]
    follow_left, follow_right = share == 1.0, share == 1.0
    if share < 1.0:
        follow_left = _lies_flat(arrays, 0) and loads[0] > least_load
        follow_right = _lies_flat(arrays, 1) and loads[1] > least_load
        _drift(arrays, (loads[0] if follow_left else 0.0, loads[1] if follow_right else 0.0))
    _note_soles(arrays)
    _move_footholds(arrays, follow_left, follow_right, share)
    _place_reference(arrays, velocity, reference)
    reference[0, 2] -= _drop(arrays, leg)
    height = reference[0, 2] - arrays.anchor[2]
    omega = np.sqrt(GRAVITY / max(height, COM_HEIGHT_MIN))
    reference[8, 0] = reference[0, 0] + reference[1, 0] / omega
    reference[8, 1] = reference[0, 1] + reference[1, 1] / omega
    reference[8, 2] = height


@register_jitable
def _lies_flat(arrays: BalanceArrays, foot: int) -> bool:
    """Whether a sole has no free axis except those in ``turning``."""
    return not (arrays.edges.free[foot] & ~arrays.turning[foot]).any()


@register_jitable
def _place(pose: Array) -> Place:
    return pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0]), pose[2, 3]


@njit(cache=True)
def _note_soles(arrays: BalanceArrays) -> None:
    for foot in range(2):
        arrays.seen[foot] = _place(arrays.poses[foot])


@njit(cache=True)
def _drift(arrays: BalanceArrays, loads: Point) -> None:
    """Move the footholds by the ``common_motion`` of the soles in W since the last tick, weighted by loads [N]."""
    seen = arrays.seen
    before = (seen[0, 0], seen[0, 1], seen[0, 2], seen[0, 3]), (seen[1, 0], seen[1, 1], seen[1, 2], seen[1, 3])
    after = _place(arrays.poses[0]), _place(arrays.poses[1])
    (x, y), (way_x, way_y, turn) = common_motion(before, after, loads, 0.0)
    for foot in range(2):
        place, rotation = arrays.positions[foot], arrays.rotations[foot]
        ahead, left = place[0] - x, place[1] - y
        place[0], place[1] = point_at(x + way_x, y + way_y, turn, ahead, left)
        for j in range(3):
            rotation[0, j], rotation[1, j] = rotated(turn, rotation[0, j], rotation[1, j])


@njit(cache=True)
def _move_footholds(arrays: BalanceArrays, left: bool, right: bool, share: float) -> None:
    """Move the footholds towards their soles, and the anchor to their midpoint, at their mean heading.

    The anchor is level, since a sole that tips on its edge under a push must not tilt the references.
    ``share`` is the fraction of the distance to move in this tick [-].
    """
    rotations, positions, anchor_rotation = arrays.rotations, arrays.positions, arrays.anchor_rotation
    if left:
        follow_pose(rotations[0], positions[0], arrays.poses[0], share)
    if right:
        follow_pose(rotations[1], positions[1], arrays.poses[1], share)
    for i in range(3):
        arrays.anchor[i] = 0.5 * (positions[0, i] + positions[1, i])
    cosine = rotations[0, 0, 0] + rotations[1, 0, 0]
    sine = rotations[0, 1, 0] + rotations[1, 1, 0]
    length = np.sqrt(cosine * cosine + sine * sine)
    cosine /= length
    sine /= length
    anchor_rotation[:, :] = 0.0
    anchor_rotation[0, 0] = anchor_rotation[1, 1] = cosine
    anchor_rotation[0, 1], anchor_rotation[1, 0] = -sine, sine
    anchor_rotation[2, 2] = 1.0


@njit(cache=True)
def _place_reference(arrays: BalanceArrays, velocity: Array, out: Array) -> None:
    """Write CoM, ``velocity`` (3,), base and torso rotations of the posture, in W, into the first 8 rows of ``out``."""
    turn = arrays.anchor_rotation
    out[:8] = 0.0
    for i in range(3):
        out[0, i] = arrays.anchor[i]
        for k in range(3):
            out[0, i] += turn[i, k] * arrays.posture_com[k]
            out[1, i] += turn[i, k] * velocity[k]
        for j in range(3):
            for k in range(3):
                out[2 + i, j] += turn[i, k] * arrays.posture_base[k, j]
                out[5 + i, j] += turn[i, k] * arrays.posture_torso[k, j]


@njit(cache=True)
def _drop(arrays: BalanceArrays, leg: float) -> float:
    """Descent of the CoM for soles farther apart than in 'stand', with legs no longer than in 'stand' [m]."""
    square = 0.0
    for axis in range(2):
        away = -arrays.apart[axis]
        for k in range(3):
            away += arrays.anchor_rotation[k, axis] * (arrays.positions[0, k] - arrays.positions[1, k])
        square += away * away
    half = min(max(0.5 * np.sqrt(square) - _STANCE, 0.0), 0.5 * leg)
    return float(leg - np.sqrt(leg * leg - half * half))


@njit(cache=True)
def feedback_tick(
    balance: Unboxed[BalanceArrays],
    left: bool,
    right: bool,
    com: Array,
    com_velocity: Array,
    rise: float,
    dcm: Array,
    dcm_velocity: Array,
    led: bool,
    sole_positions: Array,
    shift: Array,
    momentum: float,
    levels: tuple[float, float],
) -> float:
    """DCM feedback of ``BalanceController``; returns the capture margin [m].

    Writes, in W, the measured DCM ``dcm`` (2,) [m], the admissible CMP ``cmp`` (2,) [m] and the CoM acceleration
    ``acceleration`` (3,) [m/s^2] of the record.

    ``left`` and ``right`` are true for feet planned to bear load; both count if neither is. ``rise`` is the vertical
    acceleration of the CoM reference [m/s^2], included in the force at the CMP. With ``led``, ``dcm`` and
    ``dcm_velocity`` (2,) replace the horizontal part of the CoM reference. ``shift`` is the shift of the CMP by the
    planned reaction of the swing leg (2,) [m]; ``momentum`` is the share of the largest reach beyond the edge [-].
    ``levels`` are as in ``Reference``: ``omega`` uses the height above the ground, the force the height above the ZMP.
    """
    arrays = balance.record
    measured, gains = arrays.com, arrays.gains
    soles, corners = arrays.poses[:2].copy(), arrays.corners.copy()
    if left == right:
        ground = 0.5 * (sole_positions[0, 2] + sole_positions[1, 2])
    else:
        stance = 0 if left else 1
        ground = sole_positions[stance, 2]
        # Shift the stance sole, so that the CMP is inside the shifted sole if the CoP is inside the real one.
        reach = gains[7]
        for i in range(2):
            soles[stance, i, 3] += min(max(shift[i], -reach), reach)
        soles[1 - stance], corners[1 - stance] = soles[stance], corners[stance]
    height = max(measured[2] - ground - levels[0], COM_HEIGHT_MIN)
    omega, over = np.sqrt(GRAVITY / height), height / max(measured[2] - ground - levels[1], COM_HEIGHT_MIN)
    position, velocity = com.copy(), com_velocity.copy()
    if led:  # CoM reference with this DCM and its velocity
        for i in range(2):
            velocity[i] = dcm_velocity[i]
            position[i] = dcm[i] - velocity[i] / omega
    points, hull, desired = np.zeros((8, 2)), np.zeros((20, 2)), np.zeros(2)
    for i in range(2):
        arrays.dcm[i] = measured[i] + arrays.com_velocity[i] / omega
        drift = velocity[i] / omega
        desired[i] = arrays.dcm[i] - drift + gains[0] * (arrays.dcm[i] - position[i] - drift)
    for foot in range(2):
        pose = soles[foot]
        for corner in range(4):
            for i in range(2):
                points[4 * foot + corner, i] = (
                    pose[i, 3]
                    + pose[i, 0] * corners[foot, corner, 0]
                    + pose[i, 1] * corners[foot, corner, 1]
                    + pose[i, 2] * corners[foot, corner, 2]
                )
    count = convex_hull(points, hull)
    largest = momentum * gains[4]
    margin = cmp_command(hull, count, arrays.dcm, desired, gains[1], gains[2], gains[3], largest, arrays.cmp)
    for i in range(2):
        arrays.acceleration[i] = omega * omega * (1.0 + rise / GRAVITY) * over * (measured[i] - arrays.cmp[i])
    below, rate = position[2] - measured[2], velocity[2] - arrays.com_velocity[2]
    arrays.acceleration[2] = rise + gains[5] * below + gains[6] * rate
    return float(margin)


@njit(cache=True)
def blend_rotations(first: Array, second: Array, share: float, out: Array) -> None:
    """Interpolate rotations (n, 3, 3) by a share from ``first`` to ``second``, along the shortest rotation."""
    pose, unused = np.eye(4), np.zeros(3)
    for k in range(first.shape[0]):
        out[k] = first[k]
        pose[:3, :3] = second[k]
        follow_pose(out[k], unused, pose, share)


@njit(cache=True)
def blend_postures(
    free: NDArray[np.bool_], share: float, first: tuple[Array, ...], second: tuple[Array, ...], blended: Array
) -> None:
    """Interpolate posture, velocity and acceleration (3, nj) between two; ``free`` joints take the first."""
    for j in range(free.shape[0]):
        weight = 0.0 if free[j] else share
        blended[0, j] = first[0][j] + weight * (second[0][j] - first[0][j])
        blended[1, j] = first[1][j] + weight * (second[1][j] - first[1][j])
        blended[2, j] = (1.0 - weight) * first[2][j] + weight * second[2][j]
