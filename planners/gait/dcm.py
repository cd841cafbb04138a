r"""DCM reference over footholds: closed forms of the linear inverted pendulum for each phase.

Symbols: ``xi = c + c'/omega`` is the divergent component of motion, ``p`` the ZMP, ``omega = sqrt(g / z)``. The
pendulum has ``xi' = omega (xi - p)``. A step of duration ``T = T_d + T_s`` begins at the touchdown of the new stance
foot. In the double support ``T_d``, the ZMP moves at constant speed from the ZMP point of the old stance foot to that
of the new one. In the single support ``T_s``, it stays there.

References:
    Englsberger, Ott, Albu-Schaeffer: Three-dimensional bipedal walking control based on divergent component of motion
    (2015); Khadiv, Herzog, Moosavian, Righetti: Walking control based on step timing adaptation (2020).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct, structs

from models.numerics.compiled import njit, register_jitable
from models.numerics.unboxed import Unboxed
from models.types import Matrix, Vector
from planners.gait.footsteps import Point, Preview, point_at
from planners.gait.pace import Pace, with_single
from planners.gait.reaction import Body, SwingLeg, cmp_offset, rest_of_swing, swing_slope, whole_swing
from planners.gait.swing import SwingMotion


class StepModel(NamedTuple):
    """Constants of a step, for compiled code."""

    points: Matrix  # ZMP point of each sole in its frame (2, 2) [m]
    leg: SwingLeg


@register_jitable
def transfer_share(omega: float, double: float) -> float:
    r"""``alpha = (1 - exp(-omega T_d)) / (omega T_d)``: share of an initial ZMP step that is equivalent to a ZMP ramp.

    .. math:: \xi(T) = p_i + e^{\omega T} (\xi_0 - p_{i-1} - \alpha (p_i - p_{i-1}))
    """
    x = omega * double
    return (1.0 - math.exp(-x)) / x if x > 1e-9 else 1.0


@register_jitable
def touchdown_offset(
    points: Matrix, swings: Matrix, omega: float, singles: Vector, double: float, final: Vector
) -> Point:
    r"""DCM offset ``b = xi - p_1`` at the coming touchdown, by backward recursion over the previewed footholds [m].

    .. math:: b_i = e^{-\omega T} (b_{i+1} + p_{i+1} - p_i) - (1 - \alpha) (p_i - p_{i-1}) + e^{-\omega T_d} d_i

    ``swings`` (steps - 1, 2) [m] are the reactions d_i of the leg that swings from p_{i-1} to p_{i+1}
    (``reaction.py``). The recursion contracts by ``exp(omega T)`` per step, so the end of a preview of three or four
    steps has little effect. At the end, the DCM ``final`` (2,) [m] is over the last foothold (capturable), or over the
    middle of the stance if the walk ends there. ``points`` are p_0 (stance), p_1, ... (1 + steps, 2) [m], ``singles``
    are T_s of the steps to them (1 + steps,) and ``double`` is T_d [s].
    """
    share = 1.0 - transfer_share(omega, double)
    fade = math.exp(-omega * double)
    last = points.shape[0] - 1
    x, y = final[0] - points[last, 0], final[1] - points[last, 1]
    for i in range(last - 1, 0, -1):
        before, here, after, swing = points[i - 1], points[i], points[i + 1], swings[i - 1]
        decay = math.exp(-omega * (singles[i + 1] + double))
        x = decay * (x + after[0] - here[0]) - share * (here[0] - before[0]) + fade * swing[0]
        y = decay * (y + after[1] - here[1]) - share * (here[1] - before[1]) + fade * swing[1]
    return x, y


@register_jitable
def previewed_offset(steps: Preview, foot: int, ends: bool, omega: float, pace: Pace, model: StepModel) -> Point:
    """DCM offset from the next ZMP point at the coming touchdown, in W [m]; ``foot`` swings first.

    ``steps`` are the stance and the coming footholds. If ``ends``, the walk ends at the last one.
    """
    count = len(steps)
    points, swings = np.empty((count, 2)), np.empty((count - 2, 2))
    for i in range(count):
        centre = model.points[foot if i % 2 == 1 else 1 - foot]
        points[i, 0], points[i, 1] = point_at(steps[i]["x"], steps[i]["y"], steps[i]["yaw"], centre[0], centre[1])
    for i in range(count - 2):
        way = points[i + 2, 0] - points[i, 0], points[i + 2, 1] - points[i, 1]
        rise = steps[i + 2]["rise"] - steps[i]["rise"]
        slow, yaw, over = with_single(pace, steps[i + 2]["time"]), steps[0]["yaw"], steps[i + 2]["over"]
        swings[i, 0], swings[i, 1] = whole_swing(omega, slow, way, yaw, model.leg, rise, over)
    final = 0.5 * (points[count - 1] + points[count - 2]) if ends else points[count - 1]
    return touchdown_offset(points, swings, omega, np.maximum(steps["time"], pace.single), pace.double, final)


@njit(cache=True)
def height_at_touchdown(steps: Preview, ends: bool, omega: float, pace: Pace) -> float:
    r"""Vertical DCM at the coming touchdown relative to the one over the stance foot, from known heights [m].

    The vertical DCM also diverges from the stance foot, :math:`\xi_z' = \omega (\xi_z - z_i)`, so the same recursion
    holds. The CoM converges to it and rises as it moves ahead, with the same constant ``omega``:
    ``(g + z'') / (z - z_i)`` is ``omega^2``, and the force passes through the ZMP.

    References:
        Englsberger, Ott, Albu-Schaeffer (2015), section III: DCM and virtual repellent point in three dimensions.
    """
    last, rises = len(steps) - 1, steps["rise"]
    points, final = np.zeros((last + 1, 2)), np.zeros(2)
    points[:, 0] = rises
    final[0] = 0.5 * (rises[last] + rises[last - 1]) if ends else rises[last]
    singles = np.maximum(steps["time"], pace.single)
    offset = touchdown_offset(points, np.zeros((last, 2)), omega, singles, pace.double, final)
    return float(rises[1] + offset[0])


@register_jitable
def offset_coupling(omega: float, pace: Pace, step: StepModel) -> float:
    """Change of the DCM offset at touchdown per change of the foothold [-]; see ``touchdown_offset``."""
    fade = math.exp(-omega * pace.double)
    return transfer_share(omega, pace.double) - 1.0 + fade * swing_slope(omega, pace.single, step.leg.lever)


@register_jitable
def pendulum(point: Vector, end: Vector, omega: float, left: float, rest: Point, offset: Point, out: Matrix) -> None:
    """Fill DCM and its rate (2, 2) in single support, ``left`` [s] before the touchdown with the DCM ``end`` (2,) [m].

    ``point`` is the ZMP point of the stance foot (2,) [m]. ``rest`` is the DCM shift by the rest of the swing [m]
    (``reaction.py``), ``offset`` is the present CMP minus CoP [m].
    """
    decay = math.exp(-omega * left)
    for i in range(2):
        out[0, i] = point[i] + decay * (end[i] - point[i]) + rest[i]
        out[1, i] = omega * (out[0, i] - point[i] - offset[i])


@njit(cache=True)
def single_support(
    point: Vector, end: Vector, omega: float, left: float, swing: SwingMotion, body: Body, leg: Unboxed[SwingLeg],
    out: Matrix,
) -> None:  # fmt: skip
    """Fill DCM, its rate, and CMP minus CoP (3, 2) [m, m/s, m], ``left`` [s] before the touchdown.

    ``point`` is the ZMP point of the stance foot and ``end`` the DCM at touchdown (2,) [m].
    """
    rest = rest_of_swing(omega, left, swing, body, leg.record)
    offset = cmp_offset(swing[0], body[0], body[1], leg.record.lever)
    pendulum(point, end, omega, max(left, 0.0), rest, offset, out)
    out[2, 0], out[2, 1] = offset


@njit(cache=True)
def double_support(
    old: Vector, new: Vector, end: Vector, omega: float, elapsed: float, duration: float
) -> tuple[Vector, Vector]:
    """DCM and its rate while the ZMP moves from ``old`` to ``new`` (2,) in ``duration``; ``end`` is the final DCM.

    ``elapsed`` is the time since the planned touchdown [s]. While it is negative, the ZMP stays at ``old``.
    """
    early, elapsed = min(elapsed, 0.0), max(elapsed, 0.0)
    dcm, rate, decay = np.empty(2), np.empty(2), math.exp(-omega * (duration - elapsed))
    for i in range(2):
        speed = (new[i] - old[i]) / duration
        zmp, slope = old[i] + speed * elapsed, speed / omega
        dcm[i] = zmp + slope + decay * (end[i] - new[i] - slope)
        rate[i] = omega * (dcm[i] - zmp)
    if early < 0.0:
        out = np.empty((2, 2))
        pendulum(old, dcm, omega, -early, (0.0, 0.0), (0.0, 0.0), out)
        return out[0], out[1]
    return dcm, rate


@njit(cache=True)
def blend(
    start: tuple[Vector, Vector], end: tuple[Vector, Vector], elapsed: float, duration: float
) -> tuple[Vector, Vector]:
    """Cubic between two DCM states (position, rate), each (2,): shift before the first and after the last step."""
    u = min(max(elapsed / duration, 0.0), 1.0)
    h00, h10 = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * (1.0 - u) ** 2
    h01, h11 = u * u * (3.0 - 2.0 * u), u * u * (u - 1.0)
    d00, d10, d11 = 6.0 * u * (u - 1.0), (1.0 - u) * (1.0 - 3.0 * u), u * (3.0 * u - 2.0)
    dcm, rate = np.empty(2), np.empty(2)
    for i in range(2):
        (x, v), (x_end, v_end) = (start[0][i], start[1][i]), (end[0][i], end[1][i])
        dcm[i] = h00 * x + h10 * duration * v + h01 * x_end + h11 * duration * v_end
        rate[i] = (d00 * x - d00 * x_end) / duration + d10 * v + d11 * v_end
    return dcm, rate


class DcmState(Struct, frozen=True):
    """DCM reference of one tick."""

    dcm: Vector  # in W (2,) [m]
    rate: Vector  # in W (2,) [m/s]
    start: tuple[Vector, Vector]  # DCM and rate at the start of the present blend
    old: Vector  # ZMP point of the stance foot of the last single support (2,) [m]

    @staticmethod
    def at_rest(dcm: Vector, old: Vector | None = None) -> DcmState:
        """State at rest at a DCM (2,) [m]."""
        rate = np.zeros(2)
        return DcmState(dcm, rate, (dcm, rate), np.zeros(2) if old is None else old)

    def shifted(self, shift: Vector) -> DcmState:
        """State shifted in W (2,) [m]."""
        return DcmState(self.dcm + shift, self.rate, (self.start[0] + shift, self.start[1]), self.old + shift)

    def zmp(self, omega: float) -> Vector:
        """ZMP of the reference (2,) [m]."""
        zmp: Vector = self.dcm - self.rate / omega
        return zmp

    def begin_blend(self) -> DcmState:
        """State whose next blend starts from the present reference."""
        return structs.replace(self, start=(self.dcm, self.rate))

    def blended(self, end: Vector, rate: Vector, elapsed: float, duration: float) -> DcmState:
        """State on both feet, blended from the start to a DCM (2,) [m] and rate (2,) [m/s]."""
        dcm, now = blend(self.start, (end, rate), elapsed, duration)
        return DcmState(dcm, now, self.start, self.old)

    def in_single(self, point: Vector, dcm: Vector, rate: Vector) -> DcmState:
        """State in single support on the ZMP point (2,) [m] of a foot; see ``single_support``."""
        return DcmState(dcm, rate, self.start, point)

    def in_double(self, new: Vector, touchdown: Vector, omega: float, elapsed: float, duration: float) -> DcmState:
        """State in double support, from the last stance foot to the new one and its ZMP point ``new`` (2,) [m].

        ``touchdown`` is the DCM at the planned touchdown (2,) [m], ``elapsed`` the time since then [s]. After an early
        touchdown, ``elapsed`` is negative and the pendulum continues as in single support. The reference stays
        continuous for any foothold (``transfer_share``): the next step corrects a foothold error, not this short phase.
        """
        moved = transfer_share(omega, duration) * (new - self.old)
        end = new + math.exp(omega * duration) * (touchdown - self.old - moved)
        dcm, rate = double_support(self.old, new, end, omega, elapsed, duration)
        return DcmState(dcm, rate, self.start, self.old)
