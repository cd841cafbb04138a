"""Footholds: poses of the soles on the floor, and the next footholds of a walk at a velocity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from models.numerics.compiled import njit, register_jitable
from models.numerics.unboxed import Unboxed, unbox
from models.types import Velocity
from planners.gait.config import ReachConfig

T = TypeVar("T")

LEFT, RIGHT = 0, 1

Pose = tuple[float, float, float]  #: x, y in W [m], heading in W [rad]
Point = tuple[float, float]  #: x, y [m]
Place = tuple[float, float, float, float]  #: x, y in W [m], heading [rad], height z [m]
#: A stance or a coming foothold, for compiled code: pose in W, known height above the stance [m], height of an obstacle
#: that the foot passes (``Tread.over``) [m], and least single support of the step [s]
PREVIEWED = np.dtype([(name, float) for name in ("x", "y", "yaw", "rise", "over", "time")])
Preview = NDArray[np.void]  #: The stance and the coming footholds (1 + steps,) of ``PREVIEWED``


class StepLimits(NamedTuple):
    """``ReachConfig`` for compiled code: widths and lengths [m], turns [rad]."""

    width: float
    width_min: float
    width_max: float
    forward: float
    backward: float
    turn_in: float
    turn_out: float


def limits_of(reach: ReachConfig) -> StepLimits:
    """Limits of the footholds of ordinary steps."""
    r = reach
    return StepLimits(r.width, r.width_min, r.width_max, r.forward, r.backward, r.turn_in, r.turn_out)


@register_jitable
def point_at(x: float, y: float, yaw: float, forward: float, left: float) -> Point:
    """Point in W, from its coordinates in the frame of a pose [m]."""
    c, s = math.cos(yaw), math.sin(yaw)
    return x + c * forward - s * left, y + s * forward + c * left


@register_jitable
def relative_to(x: float, y: float, yaw: float, px: float, py: float) -> Point:
    """Point of W in the frame of a pose [m]."""
    c, s = math.cos(yaw), math.sin(yaw)
    return c * (px - x) + s * (py - y), -s * (px - x) + c * (py - y)


@register_jitable
def rotated(angle: float, x: float, y: float) -> Point:
    """Vector rotated by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return c * x - s * y, s * x + c * y


@register_jitable
def wrap(angle: float) -> float:
    """Angle wrapped to [-pi, pi]; a mirrored angle wraps to exactly the opposite value."""
    if -math.pi < angle < math.pi:
        return angle
    turn = 2.0 * math.pi
    return angle - turn * float(np.rint(angle / turn))  # ties go to the even number, on both sides of zero


@register_jitable
def mean_heading(first: float, second: float) -> float:
    """Heading half-way between two [rad]."""
    yaw = 0.5 * (first + second)
    if math.cos(first - yaw) < 0.0:  # two angles have two means: take the other one
        yaw -= math.copysign(math.pi, yaw)
    return wrap(yaw)


@register_jitable
def common_motion(
    before: tuple[Place, Place], after: tuple[Place, Place], loads: Point, least: float
) -> tuple[Point, Pose]:
    """Load-weighted centre [m] and planar motion [m, m, rad] of the soles that bear at least ``least``; zero if none.

    ``loads`` and ``least`` have the same unit. No sensor observes position and heading, so their estimates drift, and
    soles on the floor appear to move together.
    """
    x, y, way_x, way_y, turn, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for foot in range(2):
        old, new, load = before[foot], after[foot], loads[foot]
        if load >= least and load > 0.0:
            x, y = x + load * old[0], y + load * old[1]
            way_x, way_y = way_x + load * (new[0] - old[0]), way_y + load * (new[1] - old[1])
            turn += load * wrap(new[2] - old[2])
            total += load
    if total == 0.0:
        return (0.0, 0.0), (0.0, 0.0, 0.0)
    return (x / total, y / total), (way_x / total, way_y / total, turn / total)


class Foothold(Struct, frozen=True):
    """Pose of a sole on the floor in W: x, y, height z of the floor [m], heading yaw [rad]."""

    x: float
    y: float
    yaw: float
    z: float = 0.0

    @property
    def pose(self) -> Pose:
        """x, y in W [m] and heading [rad]."""
        return self.x, self.y, self.yaw

    @property
    def place(self) -> Place:
        """x, y in W [m], heading [rad] and height [m]."""
        return self.x, self.y, self.yaw, self.z

    def moved(self, forward: float, left: float) -> Point:
        """Point in W, from its coordinates in this foothold's frame [m]."""
        return point_at(self.x, self.y, self.yaw, forward, left)

    def relative(self, x: float, y: float) -> Point:
        """Point of W in this foothold's frame [m]."""
        return relative_to(self.x, self.y, self.yaw, x, y)

    def shifted(self, x: float, y: float) -> Foothold:
        """This foothold moved in W [m]."""
        return Foothold(self.x + x, self.y + y, self.yaw, self.z)


Feet = tuple[Foothold, Foothold]  #: Footholds of the left and the right sole


def replaced(pair: tuple[T, T], foot: int, value: T) -> tuple[T, T]:
    """Values of both feet, with the value of one foot replaced."""
    return (value, pair[1]) if foot == LEFT else (pair[0], value)


def side_of(foot: int) -> float:
    """+1 for the left foot, -1 for the right one."""
    return 1.0 if foot == LEFT else -1.0


@register_jitable
def clamp_pose(stance: Pose, side: float, target: Pose, limits: StepLimits) -> Pose:
    """Pose within the limits nearest to a target of the swing foot (``side`` +1 left, -1 right)."""
    forward, left = relative_to(stance[0], stance[1], stance[2], target[0], target[1])
    forward = min(max(forward, -limits.backward), limits.forward)
    width = min(max(side * left, limits.width_min), limits.width_max)
    opening = min(max(side * wrap(target[2] - stance[2]), -limits.turn_in), limits.turn_out)
    x, y = point_at(stance[0], stance[1], stance[2], forward, side * width)
    return x, y, stance[2] + side * opening


@register_jitable
def next_pose(stance: Pose, side: float, advance: Pose, limits: StepLimits) -> Pose:
    r"""Pose of the swing foot (``side`` +1 left, -1 right) after one step from the stance.

    The centre of the body is half a step width inwards of the stance sole. It moves by ``v T`` and turns by ``w T``
    (``advance``: forward, left [m], turn [rad]); the swing sole lands half a width outwards of it. In lateral steps and
    turns, the leading foot opens and the trailing foot closes. The trailing foot must not cross or turn in too far; the
    leading foot makes up for it, so that the mean velocity is the commanded one:

    .. math:: d_{trail} = \max(w - |v_y| T, w_{min}), \quad d_{lead} = d_{trail} + 2 |v_y| T

    and likewise for the turn of the soles.
    """
    forward, left, turn = advance
    out = side * left  # towards the swing foot's side
    # Turn of the swing sole from the stance sole, outwards positive.
    trailing = max(-abs(turn), -limits.turn_in)
    opening = trailing + 2.0 * abs(turn) if side * turn >= 0.0 else trailing
    opening = min(max(opening, -limits.turn_in), limits.turn_out)
    closing = max(limits.width - abs(left), limits.width_min)
    across = side * (closing + 2.0 * abs(left) if out >= 0.0 else closing)
    half_turn = 0.5 * side * opening
    # Displacement in the frame midway between the two headings, so that mirrored steps make mirrored, closed paths.
    c, s = math.cos(half_turn), math.sin(half_turn)
    x, y = point_at(stance[0], stance[1], stance[2], c * forward - s * across, s * forward + c * across)
    return clamp_pose(stance, side, (x, y, stance[2] + half_turn + half_turn), limits)


@njit(cache=True)
def _preview(stance: Pose, foot: int, advance: Pose, limits: Unboxed[StepLimits], count: int) -> Preview:
    """The stance and ``count`` steps of alternating feet, ``foot`` first (1 + count,)."""
    steps = np.zeros(1 + count, PREVIEWED)
    steps[0]["x"], steps[0]["y"], steps[0]["yaw"] = stance
    side, bounds = 1.0 if foot == LEFT else -1.0, limits.record
    for i in range(1, 1 + count):
        last = steps[i - 1]["x"], steps[i - 1]["y"], steps[i - 1]["yaw"]
        steps[i]["x"], steps[i]["y"], steps[i]["yaw"] = next_pose(last, side, advance, bounds)
        side = -side
    return steps


def preview_steps(
    stance: Foothold,
    foot: int,
    velocity: Velocity,
    period: float,
    limits: Unboxed[StepLimits],
    count: int,
    stop_after: int | None = None,
) -> Preview:
    """Stance and ``preview_footholds`` on level ground (1 + steps,)."""
    if stop_after is not None:
        count = max(min(count, stop_after), 1)
        velocity = (0.0, 0.0, 0.0)
    steps: Preview = _preview(stance.pose, foot, advance_of(velocity, period), limits, count)
    return steps


def preview_footholds(
    stance: Foothold,
    foot: int,
    velocity: Velocity,
    period: float,
    reach: ReachConfig,
    count: int,
    stop_after: int | None = None,
) -> list[Foothold]:
    """Next ``count`` footholds, ``foot`` first; with ``stop_after``, at most that many steps on the spot."""
    steps = preview_steps(stance, foot, velocity, period, unbox(limits_of(reach)), count, stop_after)
    return [Foothold(x, y, yaw, stance.z) for x, y, yaw, *_ in steps[1:].tolist()]


def advance_of(velocity: Velocity, period: float) -> Pose:
    """Displacement of the body by a velocity in a time [s]: forward, left [m], turn [rad]."""
    return velocity[0] * period, velocity[1] * period, velocity[2] * period


def next_foothold(stance: Foothold, foot: int, velocity: Velocity, period: float, reach: ReachConfig) -> Foothold:
    """Foothold of ``foot`` after one step of ``period`` [s] from a stance; see ``next_pose`` for the law."""
    pose = next_pose(stance.pose, side_of(foot), advance_of(velocity, period), limits_of(reach))
    return Foothold(*pose, stance.z)


def clamped(stance: Foothold, foot: int, x: float, y: float, yaw: float, limits: StepLimits) -> Foothold:
    """Foothold within the limits nearest to a target of the swing foot."""
    return Foothold(*clamp_pose(stance.pose, side_of(foot), (x, y, yaw), limits), stance.z)


def middle(soles: Sequence[Foothold]) -> Foothold:
    """Pose midway between both soles: the pose of a robot on both feet."""
    left, right = soles
    yaw = mean_heading(left.yaw, right.yaw)
    return Foothold(0.5 * (left.x + right.x), 0.5 * (left.y + right.y), yaw, 0.5 * (left.z + right.z))
