"""The pendulum that tests of the DCM's closed forms walk, and where its steps begin."""

from collections.abc import Sequence

import numpy as np

from models.types import Vector
from planners.gait import dcm

OMEGA = 3.85  # [1/s]
SINGLE, DOUBLE = 0.34, 0.08  # [s]


def touchdown_offset(
    points: Sequence[Vector], swing: tuple[float, float] = (0.0, 0.0), final: Vector | None = None
) -> Vector:
    """Where the DCM is to be at the touchdown on the second of these footholds, seen from it (2,) [m].

    Args:
        points: Footholds, from the one that bears now (n, 2) [m].
        swing: What the reaction of each swing uses up (2,) [m].
        final: DCM in the end; over the last foothold when None (2,) [m].
    """
    swings = np.tile(swing, (len(points) - 2, 1))
    end = points[-1] if final is None else final
    return np.array(dcm.touchdown_offset(np.array(points), swings, OMEGA, np.full(len(points), SINGLE), DOUBLE, end))
