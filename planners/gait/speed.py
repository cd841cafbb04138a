r"""A walk makes the commanded velocity: its steps are asked for as much more as they were found to fall short.

A swing foot lags, a sole lands early, the DCM trails its reference: the steps of a velocity ``v`` are some percent
shorter than planned, more at high speed, and those to one side go a little ahead, too. So the nominal step is that of
``v + E v``. The matrix ``E`` is learned at each touchdown from the velocity that the foot has made since it last lay on
the floor, over two steps of duration T, by normalised least mean squares:

.. math:: E \leftarrow E + \gamma \frac{e\,v^T}{v^T v}, \qquad e = v - \frac{d}{2 T}, \quad |e_i| \le e_{max} |v|,
    \quad |E_{ij}| \le e_{max}

with every component in parts of its speed at which the gait is fast. ``d`` is the way of the middle between the feet,
along the arc. Both ends are soles on the floor, so the drift of the estimate is not in it. Only steps at a steady
velocity count, on ground that is not rough, that were not urgent.

References:
    Widrow, Stearns: Adaptive signal processing, 1985, chapter 6.
"""

import math

import numpy as np
from msgspec import Struct

from models.types import Velocity
from planners.gait.config import PaceConfig, SpeedConfig
from planners.gait.footsteps import Foothold, Point, rotated, wrap

Rows = tuple[Velocity, Velocity, Velocity]

_SLOW = 1e-3  #: Part of the fast speeds below which nothing is learned [-]


class SpeedTrim(Struct, frozen=True):
    """What is asked for beside a velocity."""

    matrix: Rows = ((0.0,) * 3,) * 3  #: ``E``, of the components forward, left, turn, in their units
    steady: Velocity | None = None  #: Velocity of the last step, None if it does not count

    def of(self, velocity: Velocity) -> Velocity:
        """The velocity whose steps make a commanded one."""
        x, y, w = velocity
        (a, b, c), (d, e, f), (g, h, i) = self.matrix
        return x + a * x + b * y + c * w, y + d * x + e * y + f * w, w + g * x + h * y + i * w

    def landed(
        self,
        velocity: Velocity,
        left: Foothold,
        reached: Foothold,
        middle: Point,
        period: float,
        config: SpeedConfig,
        pace: PaceConfig,
    ) -> "SpeedTrim":
        """After a touchdown at ``reached`` of the foot that ``left`` its place a step of ``period`` [s] before.

        ``middle`` is the place between the feet from a nominal sole [m].
        """
        if velocity != self.steady:
            return SpeedTrim(self.matrix, velocity)
        fast = np.array((pace.forward, pace.lateral, pace.turn))
        parts, units = np.array(velocity) / fast, fast / fast[:, None]
        speed = float(np.linalg.norm(parts))
        if speed < _SLOW:
            return self
        turned, (x, y), (to_x, to_y) = wrap(reached.yaw - left.yaw), left.moved(*middle), reached.moved(*middle)
        arc = 0.5 * turned / math.sin(0.5 * turned) if turned else 1.0
        ahead, aside = rotated(-(left.yaw + 0.5 * turned), arc * (to_x - x), arc * (to_y - y))
        error = parts - np.array((ahead, aside, turned)) / (2.0 * period * fast)
        error = np.clip(error, -config.most * speed, config.most * speed)
        step = config.gain / speed**2 * np.outer(error, parts)
        forward, sideways, turn = (np.clip(units * self.matrix + step, -config.most, config.most) / units).tolist()
        return SpeedTrim((tuple(forward), tuple(sideways), tuple(turn)), velocity)
