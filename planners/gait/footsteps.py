"""Next footholds from a velocity command."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from planners.gait.config import ReachConfig

LEFT, RIGHT = 0, 1

Velocity = tuple[float, float, float]
"""Forward [m/s], left [m/s], turn [rad/s], in the body's frame."""


@dataclass(frozen=True, slots=True)
class Foothold:
    """Pose of a sole on the floor.

    Attributes:
        x: In W [m].
        y: In W [m].
        yaw: Heading in W [rad].
        z: Height of the floor under it [m].
    """

    x: float
    y: float
    yaw: float
    z: float = 0.0

    def moved(self, forward: float, left: float) -> tuple[float, float]:
        """A point given in this foothold's frame, in W."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.x + c * forward - s * left, self.y + s * forward + c * left

    def relative(self, x: float, y: float) -> tuple[float, float]:
        """A point of W in this foothold's frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return c * (x - self.x) + s * (y - self.y), -s * (x - self.x) + c * (y - self.y)


def wrap(angle: float) -> float:
    """The angle in [-pi, pi]: that of the mirrored angle is exactly the opposite, so mirrored steps stay mirrored."""
    return math.remainder(angle, 2.0 * math.pi)


def next_foothold(stance: Foothold, foot: int, velocity: Velocity, period: float, reach: ReachConfig) -> Foothold:
    r"""Where the other foot is to be put after one step.

    The body's centre is half a step width inwards of the stance sole, moves on by ``v T`` and turns by ``w T``; the
    swing sole stands half a width outwards of it. Sideways and turning, the leading foot opens and the trailing foot
    closes: what the trailing foot must not do (cross, or turn in too far) the leading foot does in its stead, so the
    mean velocity stays the commanded one:

    .. math:: d_{trail} = \max(w - |v_y| T, w_{min}), \quad d_{lead} = d_{trail} + 2 |v_y| T

    and likewise for the turn of the soles.

    Args:
        stance: The sole that stays.
        foot: Which foot swings (0 left, 1 right).
        velocity: Forward [m/s], left [m/s], turn [rad/s], in the body's frame.
        period: Time of a step [s].
        reach: Limits.

    Returns:
        The foothold of the swing foot, inside the limits.
    """
    side = 1.0 if foot == LEFT else -1.0
    forward, left, turn = (component * period for component in velocity)
    out = side * left  # towards the swing foot's side
    # Turn of the swing sole from the stance sole, outwards positive.
    turn_out = side * turn
    trailing = max(-abs(turn), -reach.turn_in)
    opening = trailing + 2.0 * abs(turn) if turn_out >= 0.0 else trailing
    opening = min(max(opening, -reach.turn_in), reach.turn_out)
    closing = max(reach.width - abs(left), reach.width_min)
    width = closing + 2.0 * abs(left) if out >= 0.0 else closing
    half_turn = 0.5 * side * opening
    heading = stance.yaw + half_turn
    # Displacement in the frame half-way between the two headings: mirrored steps make mirrored, closed paths.
    c, s = math.cos(half_turn), math.sin(half_turn)
    along, across = forward, side * width
    dx, dy = c * along - s * across, s * along + c * across
    return clamped(stance, foot, *stance.moved(dx, dy), heading + half_turn, reach)


def middle(soles: Sequence[Foothold]) -> Foothold:
    """Pose half-way between both soles, which is where a robot on both feet is."""
    left, right = soles
    yaw = 0.5 * (left.yaw + right.yaw)
    if math.cos(left.yaw - yaw) < 0.0:  # the other one of the two means of angles
        yaw -= math.copysign(math.pi, yaw)
    yaw = wrap(yaw)
    return Foothold(0.5 * (left.x + right.x), 0.5 * (left.y + right.y), yaw, 0.5 * (left.z + right.z))


def clamped(stance: Foothold, foot: int, x: float, y: float, yaw: float, reach: ReachConfig) -> Foothold:
    """The foothold nearest to a wanted pose of the swing foot that the limits allow."""
    side = 1.0 if foot == LEFT else -1.0
    forward, left = stance.relative(x, y)
    forward = min(max(forward, -reach.backward), reach.forward)
    width = min(max(side * left, reach.width_min), reach.width_max)
    opening = min(max(side * wrap(yaw - stance.yaw), -reach.turn_in), reach.turn_out)
    px, py = stance.moved(forward, side * width)
    return Foothold(px, py, stance.yaw + side * opening, stance.z)


def preview_footholds(
    stance: Foothold,
    foot: int,
    velocity: Velocity,
    period: float,
    reach: ReachConfig,
    count: int,
    stop_after: int | None = None,
) -> list[Foothold]:
    """The next footholds, alternating feet.

    Args:
        stance: The sole that stays.
        foot: Which foot swings first.
        velocity: Commanded.
        period: Time of a step [s].
        reach: Limits.
        count: How many.
        stop_after: Steps after which the walk ends; the last of them are steps on the spot. None to walk on.

    Returns:
        At least one foothold.
    """
    steps: list[Foothold] = []
    if stop_after is not None:
        count = max(min(count, stop_after), 1)
        velocity = (0.0, 0.0, 0.0)
    for _ in range(count):
        stance = next_foothold(stance, foot, velocity, period, reach)
        steps.append(stance)
        foot = 1 - foot
    return steps
