r"""A walk makes the commanded velocity: its steps are asked for as much more as they were found to fall short.

A swing foot lags, a sole lands early, the DCM trails its reference: the steps of a velocity are some percent shorter
than planned, more at high speed. The nominal step is that of the velocity times a factor for each component, learned at
each touchdown from the way of the foot since it last lay on the floor, over two steps of duration T:

.. math:: f \leftarrow \mathrm{clip}\left(f + \gamma \left(1 - \frac{d}{2 v T}\right),\; 1 \pm f_{max}\right)

``d`` is the way of the middle between the feet, along the arc. Both ends are soles on the floor, so the drift of the
estimate is not in it. Only steps at a steady velocity count, on ground that is not rough, that were not urgent.
"""

import math

from msgspec import Struct

from models.types import Velocity
from planners.gait.config import SpeedConfig
from planners.gait.footsteps import Foothold, Point, rotated, wrap

_SLOW = 1e-3  #: A component below this is not commanded [m/s, rad/s]


class SpeedTrim(Struct, frozen=True):
    """Factors of the components of a velocity."""

    factors: Velocity = (1.0, 1.0, 1.0)
    steady: Velocity | None = None  #: Velocity of the last step, None if it does not count

    def of(self, velocity: Velocity) -> Velocity:
        """The velocity whose steps make a commanded one."""
        forward, left, turn = self.factors
        return forward * velocity[0], left * velocity[1], turn * velocity[2]

    def landed(
        self, velocity: Velocity, left: Foothold, reached: Foothold, middle: Point, period: float, config: SpeedConfig
    ) -> "SpeedTrim":
        """After a touchdown at ``reached`` of the foot that ``left`` its place a step of ``period`` [s] before.

        ``middle`` is the place between the feet from a nominal sole [m].
        """
        if velocity != self.steady:
            return SpeedTrim(self.factors, velocity)
        turned, (x, y), (to_x, to_y) = wrap(reached.yaw - left.yaw), left.moved(*middle), reached.moved(*middle)
        arc = 0.5 * turned / math.sin(0.5 * turned) if turned else 1.0
        ahead, aside = rotated(-(left.yaw + 0.5 * turned), arc * (to_x - x), arc * (to_y - y))
        ways = zip(self.factors, velocity, (ahead, aside, turned), strict=True)
        forward, sideways, turn = (_learned(factor, part, made / (2.0 * period), config) for factor, part, made in ways)
        return SpeedTrim((forward, sideways, turn), velocity)


def _learned(factor: float, wanted: float, made: float, config: SpeedConfig) -> float:
    if abs(wanted) < _SLOW:
        return factor
    return min(max(factor + config.gain * (1.0 - made / wanted), 1.0 - config.most), 1.0 + config.most)
