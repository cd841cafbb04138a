"""Ground that a foot or its leg would be in during a swing."""

import math
from typing import NamedTuple

from models.numerics.compiled import njit, register_jitable
from models.spline import min_jerk
from models.types import Matrix, Vector
from planners.gait.config import GaitConfig
from planners.gait.tread import clearance_over, step_crouch, swing_shares
from planners.terrain.leg_extent import LegExtents, extent_at, layer_at

_TIMES = 12  #: Number of parts of a swing, at whose ends it is checked


class SweepLimits(NamedTuple):
    """Parameters of the swing, for compiled code."""

    legs: LegExtents
    leg: float  #: Leg length [m]
    width: float  #: Nominal width between the feet [m]
    crouch: float  #: Least descent of the body from standing [m]
    clearance: float  #: ``StrideConfig.clearance`` [m]
    effort: float  #: ``StrideConfig.least_effort`` [-]
    apex: float  #: ``SwingConfig.apex``; ``edge`` and ``edge_clearance`` likewise
    edge: float
    edge_clearance: float
    early: float  #: Share of the swing before the touchdown at which it turns to the landing [-]
    higher: float  #: ``SoleConfig.higher`` [m]
    hips_behind: float  #: Distance of the hips behind the middle of the feet while the CoM is above the ZMP points [m]


class Tops(NamedTuple):
    """Highest ground across the width of a sole at places of a lattice along a line."""

    ways: Vector  #: Positions along the line (n,), equally spaced [m]
    sides: Vector  #: Positions across the line (m,), likewise [m]
    top: Matrix  #: Height (n, m), -inf if unknown [m]


def sweep_limits(config: GaitConfig, legs: LegExtents, higher: float, middle: float) -> SweepLimits:
    """Limits for a gait with soles whose ``middle`` is ahead of the ankle [m].

    The clearance is that of the slow gait, the crouch that of the fast one. A foot moved along x moves the CoM by about
    the same share as one moved along z (``LegExtents.lift``).
    """
    pace, swing = config.pace, config.swing
    return SweepLimits(
        legs,
        config.leg,
        config.reach.width,
        pace.fast.crouch,
        pace.slow.clearance,
        pace.slow.least_effort,
        swing.apex,
        swing.edge,
        swing.edge_clearance,
        swing.freeze / pace.slow.single,
        higher,
        (legs.com - config.zmp * middle) / (1.0 - 2.0 * legs.lift),
    )


@njit(cache=True)
def sweeps_ground(
    before: Vector,
    stance: Vector,
    place: Vector,
    slopes: tuple[float, float, float],
    over: float,
    ground: Tops,
    limits: SweepLimits,
    margin: float,
) -> bool:
    """Whether a leg comes within ``margin`` [m] of ground ahead or behind during a step from ``before`` to ``place``.

    Positions are along and across the line, and heights (3,) [m]. Only known ground counts, if more than ``higher``
    above the plane of the sole. The position of the swing foot is that of ``SwingFoot``. The body is upright, and its
    CoM as low as the longer leg of this step requires; so the hips are lower where a foot is raised, and behind the CoM
    by ``hips_behind``. The CoM moves between the middles of the feet about with the cube of the time, since it diverges
    from the stance foot, also upwards. ``leg_extent`` describes each leg. ``slopes`` are those of the soles along the
    line at the three positions. ``over`` is that of ``Tread`` [m].
    """
    x0, y0, z0 = before
    x1, y1, z1 = place
    clearance = clearance_over(z1 - z0, limits.clearance, limits.edge_clearance, over)
    way = math.hypot(x1 - x0, y1 - y0)
    apex, wait, settle = swing_shares(z1 - z0, clearance, way, limits.apex, limits.edge, limits.early, over)
    highest = max(z0, z1) + clearance
    wider = abs(y1 - stance[1]) - limits.width
    crouch = max(limits.crouch, step_crouch(x1 - stance[0], wider, z1 - stance[2], limits.leg))
    lift = limits.legs.lift
    for k in range(1, _TIMES + 1):
        u = k / _TIMES
        share = min(max((u - wait) / (1.0 - wait - settle), 0.0), 1.0)
        moved = limits.effort * share * share * (3.0 - 2.0 * share) + (1.0 - limits.effort) * min_jerk(share)[0]
        x, y = x0 + moved * (x1 - x0), y0 + moved * (y1 - y0)
        if u < apex:
            z = z0 + min_jerk(u / apex)[0] * (highest - z0)
        else:
            z = z1 + min_jerk((1.0 - u) / (1.0 - apex))[0] * (highest - z1)
        late = u * u * u
        hip = 0.5 * (stance[0] + x0 + late * (x1 - x0)) - limits.hips_behind
        level = 0.5 * (stance[2] + z0 + late * (z1 - z0))
        lower = (crouch + lift * (z + stance[2] - 2.0 * level)) / (1.0 - 2.0 * lift) - level
        slope = slopes[0] + moved * (slopes[2] - slopes[0])
        if _in_ground(x, y, z, slope, hip - x, lower + z, ground, limits, margin):
            return True
        if _in_ground(
            stance[0], stance[1], stance[2], slopes[1], hip - stance[0], lower + stance[2], ground, limits, margin
        ):
            return True
    return False


@register_jitable
def _in_ground(
    x: float,
    y: float,
    z: float,
    slope: float,
    ahead: float,
    lower: float,
    ground: Tops,
    limits: SweepLimits,
    margin: float,
) -> bool:
    """Whether a leg is within ``margin`` of ground: sole at x, y, z with a slope, hip ``ahead`` of it and ``lower``."""
    ways, sides, top = ground
    legs, count = limits.legs, limits.legs.table.shape[2]
    spacing = ways[1] - ways[0] if len(ways) > 1 else 1.0
    beside = sides[1] - sides[0] if len(sides) > 1 else 1.0
    column = min(max(round((y - sides[0]) / beside), 0), len(sides) - 1)
    x_min, x_max = extent_at(legs, ahead, lower, count - 1, 0), extent_at(legs, ahead, lower, count - 1, 1)
    first = max(math.ceil((x + x_min - margin - ways[0]) / spacing), 0)
    last = min(math.floor((x + x_max + margin - ways[0]) / spacing), len(ways) - 1)
    for row in range(first, last + 1):
        way = ways[row] - x
        height = top[row, column] - z
        if height - slope * way > limits.higher:
            layer = layer_at(height, count)
            low, high = extent_at(legs, ahead, lower, layer, 0), extent_at(legs, ahead, lower, layer, 1)
            if low - margin < way < high + margin:
                return True
    return False
