"""Compiled parts of the balance law."""

import numpy as np
from numpy.typing import NDArray

from controllers.balance.support import cmp_command, convex_hull
from controllers.qp.terms import follow_pose
from controllers.whole_body.config import CoMGains, DcmFeedback
from models.constants import COM_HEIGHT_MIN
from models.numerics.compiled import njit

Array = NDArray[np.float64]


def feedback_gains(config: DcmFeedback, height: CoMGains) -> tuple[float, ...]:
    """The gains in the order of ``balance_feedback`` (7,)."""
    return (
        config.dcm_gain,
        config.polygon_margin,
        config.momentum_margin,
        config.momentum_gain,
        config.momentum_reach_max,
        height.kp,
        height.kd,
    )


@njit(cache=True)
def move_footholds(
    left: Array,
    right: Array,
    loaded_left: bool,
    loaded_right: bool,
    share: float,
    rotations: Array,
    positions: Array,
    anchor_rotation: Array,
    anchor: Array,
) -> None:
    """Move the footholds with the loaded soles, and the anchor to their middle, level, at their mean heading.

    Only the heading enters the anchor: a sole that tips on its edge under a push must not tilt the references. ``left``
    and ``right`` are measured poses in W (4, 4), ``share`` the part of the way to move in this tick [-]; in and out are
    ``rotations`` (2, 3, 3) and ``positions`` (2, 3) [m], out ``anchor_rotation`` (3, 3) and ``anchor`` (3,) [m].
    """
    if loaded_left:
        follow_pose(rotations[0], positions[0], left, share)
    if loaded_right:
        follow_pose(rotations[1], positions[1], right, share)
    for i in range(3):
        anchor[i] = 0.5 * (positions[0, i] + positions[1, i])
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
def place_reference(
    anchor_rotation: Array,
    anchor: Array,
    com: Array,
    com_velocity: Array,
    base: Array,
    torso: Array,
    com_out: Array,
    velocity_out: Array,
    base_out: Array,
    torso_out: Array,
) -> None:
    """Turn CoM (3,), its velocity (3,), base and torso rotations (3, 3) from the anchor frame into W."""
    for i in range(3):
        com_out[i] = anchor[i]
        velocity_out[i] = 0.0
        for k in range(3):
            com_out[i] += anchor_rotation[i, k] * com[k]
            velocity_out[i] += anchor_rotation[i, k] * com_velocity[k]
        for j in range(3):
            base_out[i, j] = 0.0
            torso_out[i, j] = 0.0
            for k in range(3):
                base_out[i, j] += anchor_rotation[i, k] * base[k, j]
                torso_out[i, j] += anchor_rotation[i, k] * torso[k, j]


@njit(cache=True)
def balance_feedback(
    com: Array,
    com_velocity: Array,
    com_reference: Array,
    velocity_reference: Array,
    ground: float,
    gravity: float,
    left: Array,
    right: Array,
    corners: Array,
    gains: Array,
    dcm: Array,
    cmp: Array,
    acceleration: Array,
) -> float:
    """DCM feedback of ``BalanceController``: admissible CMP, CoM acceleration that it causes, capture margin [m].

    CoM, its velocity and their references are in W (3,); ``left`` and ``right`` are poses of the soles (4, 4),
    ``corners`` their contact rectangles in them (2, 4, 3) [m]. ``gains`` are DCM gain, polygon margin, momentum margin,
    momentum gain, largest reach, height kp and kd (7,). Out, in W: ``dcm`` and ``cmp`` (2,), ``acceleration`` (3,).
    """
    points = np.zeros((8, 2))
    hull = np.zeros((20, 2))
    desired = np.zeros(2)
    height = max(com[2] - ground, COM_HEIGHT_MIN)
    omega = np.sqrt(gravity / height)
    for i in range(2):
        dcm[i] = com[i] + com_velocity[i] / omega
        drift = velocity_reference[i] / omega
        desired[i] = dcm[i] - drift + gains[0] * (dcm[i] - com_reference[i] - drift)
    for foot in range(2):
        pose = left if foot == 0 else right
        for corner in range(4):
            for i in range(2):
                points[4 * foot + corner, i] = (
                    pose[i, 3]
                    + pose[i, 0] * corners[foot, corner, 0]
                    + pose[i, 1] * corners[foot, corner, 1]
                    + pose[i, 2] * corners[foot, corner, 2]
                )
    count = convex_hull(points, hull)
    margin = cmp_command(hull, count, dcm, desired, gains[1], gains[2], gains[3], gains[4], cmp)
    for i in range(2):
        acceleration[i] = omega * omega * (com[i] - cmp[i])
    acceleration[2] = gains[5] * (com_reference[2] - com[2]) + gains[6] * (velocity_reference[2] - com_velocity[2])
    return margin
