"""Preview of a walk: what the coming footholds want of the DCM at the next touchdown, in W and seen from the stance."""

from __future__ import annotations

import math

import numpy as np

from models.compiled import njit
from models.types import Matrix, Vector
from planners.gait.dcm import touchdown_offset, transfer_share
from planners.gait.kernels_steps import Point, moved, relative, rotated
from planners.gait.reaction import slope, whole_swing


@njit(
    "UniTuple(float64, 2)(float64[:, ::1], int64, boolean, float64[:, ::1], float64, float64, float64,"
    " float64[::1], float64[::1])",
    cache=True,
)
def previewed_offset(
    poses: Matrix,
    foot: int,
    ends: bool,
    centres: Matrix,
    omega: float,
    single: float,
    double: float,
    shape: Vector,
    lever: Vector,
) -> Point:
    """DCM offset wanted at the coming touchdown; see ``dcm.touchdown_offset``.

    Args:
        poses: The present stance and the coming footholds, each x, y [m] and heading [rad] in W (1 + steps, 3).
        foot: Which foot swings first (0 left, 1 right).
        ends: Whether the walk ends with the last step, over the middle of the stance.
        centres: Middle of each sole in its own frame (2, 2) [m].
        omega: Of the pendulum [1/s].
        single: Single support [s].
        double: Double support [s].
        shape: Apex, clearance and landing velocity of a swing (3,).
        lever: Of the legs (4,); see ``reaction.py``.

    Returns:
        From the ZMP point of the next foothold, in W [m].
    """
    count = poses.shape[0]
    points, swings = np.empty((count, 2)), np.empty((count - 2, 2))
    for i in range(count):
        centre = centres[foot if i % 2 == 1 else 1 - foot]
        points[i, 0], points[i, 1] = moved(poses[i, 0], poses[i, 1], poses[i, 2], centre[0], centre[1])
    for i in range(count - 2):
        way = points[i + 2, 0] - points[i, 0], points[i + 2, 1] - points[i, 1]
        swings[i, 0], swings[i, 1] = whole_swing(omega, single, single + double, way, poses[0, 2], shape, lever)
    final = 0.5 * (points[count - 1] + points[count - 2]) if ends else points[count - 1]
    return touchdown_offset(points, swings, omega, single, double, final)


@njit("float64(float64, float64, float64, float64[::1])", cache=True)
def coupled(omega: float, single: float, double: float, lever: Vector) -> float:
    """Change of the DCM offset wanted at touchdown per change of the foothold [-]; see ``dcm.touchdown_offset``.

    A longer step has a longer way for the ZMP in the double support, and a longer swing after it. Arguments as for
    ``previewed_offset``.
    """
    return transfer_share(omega, double) - 1.0 + math.exp(-omega * double) * slope(omega, single, lever)


@njit(
    "UniTuple(float64, 2)(float64[:, ::1], int64, float64[:, ::1], UniTuple(float64, 2), float64[::1],"
    " float64[::1], float64[::1], UniTuple(float64, 2), UniTuple(float64, 2), float64[:, ::1])",
    cache=True,
)
def seen_from_stance(
    poses: Matrix,
    foot: int,
    centres: Matrix,
    offset: Point,
    measured: Vector,
    used: Vector,
    place: Vector,
    lower: Point,
    upper: Point,
    seen: Matrix,
) -> Point:
    """What a step adjustment is about, in the stance frame, as ZMP points from that of the stance.

    Args:
        poses: The stance and the coming footholds, as in ``previewed_offset``.
        foot: Which foot swings (0 left, 1 right).
        centres: Middle of each sole in its own frame (2, 2) [m].
        offset: DCM offset wanted at the touchdown, in W [m].
        measured: DCM in W (2,) [m].
        used: DCM that the rest of the swing will use up, in W (2,) [m].
        place: Where the swing foot is, in W (at least 2,) [m].
        lower: Least foothold in the stance frame [m].
        upper: Largest foothold in the stance frame [m].
        seen: Out: nominal foothold, offset, DCM without what is used up, least and largest foothold, and the swing
            foot brought between them: one that is out of reach yet may stay in line with where it is (6, 2) [m].

    Returns:
        From a foothold to the ZMP point in it, and from there by the stance's own ZMP point [m].
    """
    x, y, yaw = poses[0, 0], poses[0, 1], poses[0, 2]
    bear, swing = centres[1 - foot], centres[foot]
    point = moved(x, y, yaw, bear[0], bear[1])
    landing = moved(poses[1, 0], poses[1, 1], poses[1, 2], swing[0], swing[1])
    step, zmp = relative(x, y, yaw, poses[1, 0], poses[1, 1]), relative(x, y, yaw, landing[0], landing[1])
    near = relative(x, y, yaw, place[0], place[1])
    wanted = rotated(-yaw, offset[0], offset[1])
    free = rotated(-yaw, measured[0] - point[0] - used[0], measured[1] - point[1] - used[1])
    for i in range(2):
        shift = zmp[i] - step[i] - bear[i]
        seen[0, i], seen[1, i], seen[2, i] = step[i] + shift, wanted[i], free[i]
        seen[3, i], seen[4, i] = lower[i] + shift, upper[i] + shift
        seen[5, i] = min(max(near[i], lower[i]), upper[i]) + shift
    return zmp[0] - step[0] - bear[0], zmp[1] - step[1] - bear[1]


@njit(
    "Tuple((UniTuple(float64, 2), UniTuple(float64, 2)))(float64[:, ::1], int64, float64[:, ::1], float64[::1],"
    " float64[:, ::1], UniTuple(float64, 2), UniTuple(float64, 2), float64)",
    cache=True,
)
def seen_from_world(
    poses: Matrix,
    foot: int,
    centres: Matrix,
    step: Vector,
    seen: Matrix,
    shift: Point,
    offset: Point,
    coupling: float,
) -> tuple[Point, Point]:
    """An adjusted step in W.

    Args:
        poses: The stance and the coming footholds.
        foot: Which foot swings.
        centres: Of the soles.
        step: The adjusted foothold as a ZMP point from that of the stance, in the stance frame (2,) [m].
        seen: What ``seen_from_stance`` gave.
        shift: What it returned.
        offset: DCM offset wanted at the touchdown of the nominal step, in W [m].
        coupling: Change of that per change of the foothold [-].

    Returns:
        The foothold, and the DCM wanted at the touchdown, both x, y in W [m].
    """
    x, y, yaw = poses[0, 0], poses[0, 1], poses[0, 2]
    bear = centres[1 - foot]
    point = moved(x, y, yaw, bear[0], bear[1])
    way = rotated(yaw, step[0], step[1])
    more = rotated(yaw, coupling * (step[0] - seen[0, 0]), coupling * (step[1] - seen[0, 1]))
    foothold = moved(x, y, yaw, step[0] - shift[0], step[1] - shift[1])
    return foothold, (point[0] + way[0] + offset[0] + more[0], point[1] + way[1] + offset[1] + more[1])
