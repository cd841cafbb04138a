"""Preview of a walk: what the coming footholds want of the DCM at the next touchdown."""

from __future__ import annotations

import numpy as np

from models.compiled import njit
from models.types import Matrix, Vector
from planners.gait.dcm import touchdown_offset
from planners.gait.kernels_steps import moved
from planners.gait.reaction import whole_swing


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
) -> tuple[float, float]:
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
