"""Detours around obstacles on level ground: poses to walk through, beside the obstacle."""

from __future__ import annotations

import numpy as np

from models.errors import UnreachableError
from planners.gait.footsteps import Foothold
from planners.terrain.elevation_map import Heights, lattice, off_level
from planners.terrain.ground_config import PlanConfig

_FINE = 0.05  #: Spacing of the lateral offsets that are tried [m]


def detour(ground: Heights, line: Foothold, distance: float, clearance: float, config: PlanConfig) -> list[Foothold]:
    """Poses that lead past obstacles on a line, up to ``distance`` [m]; empty if the line is free.

    They are on the nearer free side, with the heading of the line. ``clearance`` is half the width that the robot needs
    [m]. Unknown ground counts as free, and so does ground that is off the level only within ``config.doubt`` standard
    deviations: far to the sides the lidar alone measures it. Raises ``UnreachableError`` if neither side is free.
    """
    cell, half = ground.cell, 0.5 * ground.cell * len(ground.values)
    reach = cell * np.hypot(*ground.values.shape)  # no ground is known beyond
    ways, sides = np.arange(0.0, min(distance, reach) + clearance, cell), np.arange(-half, half, cell)
    points, shape = lattice(line, ways, sides), (len(ways), len(sides))
    margin = config.doubt * ground.deviations_at(points).reshape(shape)
    off = off_level(ground.at(points).reshape(shape), line.z, config.level, margin)

    def free(begin: float, end: float, side: float) -> bool:
        rows = (ways >= begin) & (ways <= end)
        return float(off[rows][:, np.abs(sides - side) <= clearance].sum()) < config.stray

    if free(0.0, distance, 0.0):
        return []
    found = ways[off[:, np.abs(sides) <= clearance].any(axis=1)]
    begin, end = float(found.min()) - clearance, float(found.max()) + clearance
    for size in np.arange(_FINE, half - clearance, _FINE).tolist():
        for side in (size, -size):
            if free(begin, end, side):
                return [Foothold(*line.moved(way, side), line.yaw, line.z) for way in (max(begin, 0.0), end)]
    raise UnreachableError(f"no way around: the ground is not level up to {half - clearance:.2f} m to either side")
