"""Compiled geometry of steps: poses (x, y [m], yaw [rad]) as tuples of numbers, limits of the reach as one tuple."""

from __future__ import annotations

import math

import numpy as np

from models.compiled import njit
from models.types import Matrix

Pose = tuple[float, float, float]
"""x, y in W [m], heading in W [rad]."""

Point = tuple[float, float]
"""x, y [m]."""

Limits = tuple[float, float, float, float, float, float, float]
"""Of the reach: nominal, least and largest width, forward, backward [m], turn inwards, turn outwards [rad]."""

_POSE, _LIMITS = "UniTuple(float64, 3)", "UniTuple(float64, 7)"


@njit("UniTuple(float64, 2)(float64, float64, float64, float64, float64)", cache=True)
def moved(x: float, y: float, yaw: float, forward: float, left: float) -> Point:
    """A point given in the frame of a pose, in W."""
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * forward - s * left, y + s * forward + c * left


@njit("UniTuple(float64, 2)(float64, float64, float64, float64, float64)", cache=True)
def relative(x: float, y: float, yaw: float, px: float, py: float) -> Point:
    """A point of W in the frame of a pose."""
    c, s = math.cos(yaw), math.sin(yaw)
    return c * (px - x) + s * (py - y), -s * (px - x) + c * (py - y)


@njit("UniTuple(float64, 2)(float64, float64, float64)", cache=True)
def rotated(angle: float, x: float, y: float) -> Point:
    """A vector turned by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


@njit("float64(float64)", cache=True)
def wrap(angle: float) -> float:
    """The angle in [-pi, pi]: that of the mirrored angle is exactly the opposite, so mirrored steps stay mirrored."""
    turn = 2.0 * math.pi
    turns: float = np.rint(angle / turn)  # halves go to the even number, on both sides of zero
    return angle - turn * turns


@njit(f"{_POSE}({_POSE}, float64, {_POSE}, {_LIMITS})", cache=True)
def clamped(stance: Pose, side: float, wanted: Pose, limits: Limits) -> Pose:
    """The pose nearest to a wanted one of the swing foot that the limits allow.

    Args:
        stance: The sole that stays.
        side: Of the swing foot, +1 left, -1 right.
        wanted: Of the swing foot.
        limits: Of the reach.
    """
    _, width_min, width_max, ahead, back, turn_in, turn_out = limits
    forward, left = relative(stance[0], stance[1], stance[2], wanted[0], wanted[1])
    forward = min(max(forward, -back), ahead)
    width = min(max(side * left, width_min), width_max)
    opening = min(max(side * wrap(wanted[2] - stance[2]), -turn_in), turn_out)
    x, y = moved(stance[0], stance[1], stance[2], forward, side * width)
    return x, y, stance[2] + side * opening


@njit(f"{_POSE}({_POSE}, float64, {_POSE}, {_LIMITS})", cache=True)
def next_pose(stance: Pose, side: float, advance: Pose, limits: Limits) -> Pose:
    r"""Where the other foot is to be put after one step.

    The body's centre is half a step width inwards of the stance sole, moves on by ``v T`` and turns by ``w T``; the
    swing sole stands half a width outwards of it. Sideways and turning, the leading foot opens and the trailing foot
    closes: what the trailing foot must not do (cross, or turn in too far) the leading foot does in its stead, so the
    mean velocity stays the commanded one:

    .. math:: d_{trail} = \max(w - |v_y| T, w_{min}), \quad d_{lead} = d_{trail} + 2 |v_y| T

    and likewise for the turn of the soles.

    Args:
        stance: The sole that stays.
        side: Of the swing foot, +1 left, -1 right.
        advance: Of the body in one step: forward ``v_x T``, left ``v_y T`` [m], turn ``w T`` [rad].
        limits: Of the reach.
    """
    forward, left, turn = advance
    width, width_min, _, _, _, turn_in, turn_out = limits
    out = side * left  # towards the swing foot's side
    # Turn of the swing sole from the stance sole, outwards positive.
    trailing = max(-abs(turn), -turn_in)
    opening = trailing + 2.0 * abs(turn) if side * turn >= 0.0 else trailing
    opening = min(max(opening, -turn_in), turn_out)
    closing = max(width - abs(left), width_min)
    across = side * (closing + 2.0 * abs(left) if out >= 0.0 else closing)
    half_turn = 0.5 * side * opening
    # Displacement in the frame half-way between the two headings: mirrored steps make mirrored, closed paths.
    c, s = math.cos(half_turn), math.sin(half_turn)
    x, y = moved(stance[0], stance[1], stance[2], c * forward - s * across, s * forward + c * across)
    return clamped(stance, side, (x, y, stance[2] + half_turn + half_turn), limits)


@njit(f"float64[:, ::1]({_POSE}, int64, {_POSE}, {_LIMITS}, int64)", cache=True)
def preview(stance: Pose, foot: int, advance: Pose, limits: Limits, count: int) -> Matrix:
    """The next steps of a walk, alternating feet.

    Args:
        stance: The sole that stays.
        foot: Which foot swings first (0 left, 1 right).
        advance: Of the body in one step: forward, left [m], turn [rad].
        limits: Of the reach.
        count: How many steps.

    Returns:
        The stance, and the steps below it (1 + count, 3).
    """
    poses = np.empty((1 + count, 3))
    poses[0, 0], poses[0, 1], poses[0, 2] = stance
    side = 1.0 if foot == 0 else -1.0
    for i in range(1, 1 + count):
        last = poses[i - 1]
        poses[i, 0], poses[i, 1], poses[i, 2] = next_pose((last[0], last[1], last[2]), side, advance, limits)
        side = -side
    return poses
