r"""Correction of the nominal steps so that a walk reaches the commanded velocity.

A swing foot lags, a sole lands early, and the DCM trails its reference. Steps at a velocity ``v`` are therefore some
percent shorter than planned, more at high speed; lateral steps also go slightly ahead. The nominal step is that of

.. math:: v + E\,r(v), \qquad r(v) = (v_x^+, v_x^-, v_y^+, v_y^-, \omega^+, \omega^-), \quad
    v^\pm = \max(\pm v, 0)

with a column for each sign of each component: steps to the left do not mirror steps to the right if the legs are
calibrated differently, and steps back do not mirror steps ahead. At each touchdown, normalised least mean squares
update the matrix ``E`` with the mean velocity of the foot since it last lay on the floor, over two steps of duration T:

.. math:: E \leftarrow E + \gamma \frac{e\,r^T}{r^T r}, \qquad e = v - \frac{d}{2 T}, \quad
    |e_i| \le e_{max} |v|, \quad |E_{ij}| \le e_{max}

Every component is relative to its speed at which the gait is fast. ``d`` is the displacement of the middle between the
feet along the arc. Both of its ends are soles on the floor, so the drift of the estimate has no effect. Only steps at a
steady velocity on ground that is not rough are used, and no urgent ones.

References:
    Haykin: Adaptive filter theory, 4th edition, 2002, chapter 6.
"""

import math

import numpy as np
from msgspec import Struct

from models.types import Velocity
from planners.gait.config import PaceConfig, SpeedConfig
from planners.gait.footsteps import Foothold, Point, rotated, wrap

Row = tuple[float, float, float, float, float, float]

_ZERO: Row = (0.0,) * 6
_SLOW = 1e-3  #: Share of the fast speeds below which nothing is learned [-]


class SpeedTrim(Struct, frozen=True):
    """Correction of the velocity of the nominal steps, learned at touchdowns."""

    matrix: tuple[Row, Row, Row] = (_ZERO, _ZERO, _ZERO)  #: ``E`` (3, 6), in the units of the velocity
    steady: Velocity | None = None  #: Velocity of the last step; None if that step is not used

    def of(self, velocity: Velocity) -> Velocity:
        """Velocity of the nominal steps for a commanded velocity [m/s, m/s, rad/s]."""
        x, y, w = velocity
        i, j, k = 0 if x > 0.0 else 1, 2 if y > 0.0 else 3, 4 if w > 0.0 else 5
        a, b, c = abs(x), abs(y), abs(w)
        forward, left, turn = self.matrix
        return (
            x + forward[i] * a + forward[j] * b + forward[k] * c,
            y + left[i] * a + left[j] * b + left[k] * c,
            w + turn[i] * a + turn[j] * b + turn[k] * c,
        )

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
        """The correction after a step of ``period`` [s] of one foot, from ``left`` to ``reached``.

        ``middle`` is the middle between the feet in the frame of a nominal sole [m]; ``pace`` has the fast speeds.
        """
        if velocity != self.steady:
            return SpeedTrim(self.matrix, velocity)
        fast = np.array((pace.forward, pace.lateral, pace.turn))
        parts, senses = np.array(velocity) / fast, np.array(_senses(velocity)) / np.repeat(fast, 2)
        units = np.repeat(fast, 2) / fast[:, None]  # (3, 6)
        speed = float(np.linalg.norm(parts))
        if speed < _SLOW:
            return self
        turned, (x, y), (to_x, to_y) = wrap(reached.yaw - left.yaw), left.moved(*middle), reached.moved(*middle)
        arc = 0.5 * turned / math.sin(0.5 * turned) if turned else 1.0
        ahead, aside = rotated(-(left.yaw + 0.5 * turned), arc * (to_x - x), arc * (to_y - y))
        error = parts - np.array((ahead, aside, turned)) / (2.0 * period * fast)
        error = np.clip(error, -config.most * speed, config.most * speed)
        step = config.gain / speed**2 * np.outer(error, senses)
        forward, sideways, turn = (np.clip(units * self.matrix + step, -config.most, config.most) / units).tolist()
        return SpeedTrim((tuple(forward), tuple(sideways), tuple(turn)), velocity)


def _senses(velocity: Velocity) -> Row:
    x, y, w = velocity
    return max(x, 0.0), max(-x, 0.0), max(y, 0.0), max(-y, 0.0), max(w, 0.0), max(-w, 0.0)
