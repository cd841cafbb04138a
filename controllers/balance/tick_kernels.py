"""The balance law's parts of one tick, each as one compiled call."""

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

_STANCE = 0.005  #: Displacement of each sole from the 'stand' stance up to which the legs are long enough [m]


class BalanceArrays(NamedTuple):
    """Memory of ``BalanceController``, and what it measures, as compiled code takes them; all in W."""

    poses: Array  #: Measured poses of both soles, and of other frames (frames, 4, 4)
    com: Array  #: Measured CoM (3,)
    com_velocity: Array  #: Its velocity (3,)
    tree: KinematicTree  #: See ``posture_reference``
    frames: TreeFrames  #: See ``posture_reference``
    edges: Edges  #: Soles that stand on an edge
    turning: NDArray[np.bool_]  #: Axes x and y about which each sole turns with its leg (2, 2)
    corners: Array  #: Of the areas that bear, in the sole frames (2, 4, 3)
    gains: Array  #: Of ``feedback_gains``, then the largest shift of the CMP [m] (8,)
    rotations: Array  #: Of the footholds (2, 3, 3)
    positions: Array  #: Of the footholds (2, 3)
    seen: Array  #: x, y [m], heading [rad] and height [m] of the soles in the last tick (2, 4)
    anchor_rotation: Array  #: See ``_move_footholds`` (3, 3)
    anchor: Array  #: See ``_move_footholds`` (3,)
    apart: Array  #: From the right to the left sole in 'stand', in the anchor frame (3,)
    posture_com: Array  #: Of the last posture, in the anchor frame (3,)
    posture_base: Array  #: Likewise (3, 3)
    posture_torso: Array  #: Likewise (3, 3)
    dcm: Array  #: Measured (2,)
    cmp: Array  #: Commanded (2,)
    acceleration: Array  #: Commanded, of the CoM (3,)


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
    """Footholds, and the references that a posture (nj,) means on them.

    ``moving`` and ``fresh`` say whether the posture has changed and whether this is the first tick. Footholds follow
    the soles that bear ``least_load`` [N], all soles where ``share``, as in ``_move_footholds``, is 1. Legs are no
    longer than ``leg`` [m], as in 'stand', unless it is 0: the CoM is lower where the soles are farther apart. Out:
    ``reference`` (9, 3), in W: CoM, its velocity, rotation of base and torso; then DCM and CoM height above the soles.
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
    """Whether a sole turns about no other axis than those about which it turns with its leg."""
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
    """Move the footholds with the ``common_motion`` of the soles in W since the last tick, weighted by loads [N]."""
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
    """Move the footholds with their soles, and the anchor to their middle, level, at their mean heading.

    The anchor is level: a sole that tips on its edge under a push must not tilt the references.
    ``share`` is the part of the way to move in this tick [-].
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
    """Write the posture's CoM, ``velocity`` (3,), base and torso rotations into the first 8 rows of ``out``, in W."""
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
    """How much lower the CoM has to be for legs no longer than in 'stand', as the soles are farther apart [m]."""
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

    ``left`` and ``right`` are the feet planned to bear load, both where neither is. ``rise`` is the vertical
    acceleration of the CoM reference [m/s^2], which the force at the CMP provides, too. With ``led``, ``dcm`` and
    ``dcm_velocity`` (2,) replace the horizontal part of the CoM reference. ``shift`` is that of the CMP by the planned
    reaction of the swing leg (2,) [m]; ``momentum`` is the share of the largest reach beyond the edge [-]. ``levels``
    are as in ``Reference``: the pendulum's ``omega`` counts from the ground under the CoM, its force from the ZMP.
    """
    arrays = balance.record
    measured, gains = arrays.com, arrays.gains
    soles, corners = arrays.poses[:2].copy(), arrays.corners.copy()
    if left == right:
        ground = 0.5 * (sole_positions[0, 2] + sole_positions[1, 2])
    else:
        stance = 0 if left else 1
        ground = sole_positions[stance, 2]
        # Where the stance sole would be for the CMP to be inside it just when the CoP is inside the real one.
        reach = gains[7]
        for i in range(2):
            soles[stance, i, 3] += min(max(shift[i], -reach), reach)
        soles[1 - stance], corners[1 - stance] = soles[stance], corners[stance]
    height = max(measured[2] - ground - levels[0], COM_HEIGHT_MIN)
    omega, over = np.sqrt(GRAVITY / height), height / max(measured[2] - ground - levels[1], COM_HEIGHT_MIN)
    position, velocity = com.copy(), com_velocity.copy()
    if led:  # the CoM reference that has this DCM and drift
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
    """Rotations a share of the way from one set to another, along the shortest turns (n, 3, 3)."""
    pose, unused = np.eye(4), np.zeros(3)
    for k in range(first.shape[0]):
        out[k] = first[k]
        pose[:3, :3] = second[k]
        follow_pose(out[k], unused, pose, share)


@njit(cache=True)
def blend_postures(
    free: NDArray[np.bool_], share: float, first: tuple[Array, ...], second: tuple[Array, ...], blended: Array
) -> None:
    """Fill posture, velocity and acceleration (3, nj) a share of the way from one to another; the first of ``free``."""
    for j in range(free.shape[0]):
        weight = 0.0 if free[j] else share
        blended[0, j] = first[0][j] + weight * (second[0][j] - first[0][j])
        blended[1, j] = first[1][j] + weight * (second[1][j] - first[1][j])
        blended[2, j] = (1.0 - weight) * first[2][j] + weight * second[2][j]
