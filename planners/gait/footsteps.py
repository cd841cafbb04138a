"""Next footholds from a velocity command."""

from __future__ import annotations

import math
from collections.abc import Sequence

from msgspec import Struct

from models.types import Matrix
from planners.gait import kernels_steps
from planners.gait.config import ReachConfig
from planners.gait.kernels_steps import Limits, Pose, next_pose, preview, wrap

LEFT, RIGHT = 0, 1

Velocity = tuple[float, float, float]
"""Forward [m/s], left [m/s], turn [rad/s], in the body's frame."""


class Foothold(Struct, frozen=True):
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
        point: tuple[float, float] = kernels_steps.moved(self.x, self.y, self.yaw, forward, left)
        return point

    @property
    def pose(self) -> Pose:
        """x, y in W [m] and heading [rad]."""
        return self.x, self.y, self.yaw

    def relative(self, x: float, y: float) -> tuple[float, float]:
        """A point of W in this foothold's frame."""
        point: tuple[float, float] = kernels_steps.relative(self.x, self.y, self.yaw, x, y)
        return point


def limits_of(reach: ReachConfig) -> Limits:
    """The limits as the compiled functions take them."""
    return (
        reach.width,
        reach.width_min,
        reach.width_max,
        reach.forward,
        reach.backward,
        reach.turn_in,
        reach.turn_out,
    )


def side_of(foot: int) -> float:
    """+1 for the left foot, -1 for the right one."""
    return 1.0 if foot == LEFT else -1.0


def next_foothold(stance: Foothold, foot: int, velocity: Velocity, period: float, reach: ReachConfig) -> Foothold:
    """Where the other foot is to be put after one step; see ``kernels_steps.next_pose`` for the law.

    Args:
        stance: The sole that stays.
        foot: Which foot swings (0 left, 1 right).
        velocity: Forward [m/s], left [m/s], turn [rad/s], in the body's frame.
        period: Time of a step [s].
        reach: Limits.

    Returns:
        The foothold of the swing foot, inside the limits.
    """
    pose = next_pose(stance.pose, side_of(foot), advance_of(velocity, period), limits_of(reach))
    return Foothold(*pose, stance.z)


def advance_of(velocity: Velocity, period: float) -> Pose:
    """How far a velocity moves the body in a time [s]: forward, left [m], turn [rad]."""
    return velocity[0] * period, velocity[1] * period, velocity[2] * period


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
    pose = kernels_steps.clamped(stance.pose, side_of(foot), (x, y, yaw), limits_of(reach))
    return Foothold(*pose, stance.z)


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
    poses = preview_poses(stance, foot, velocity, period, limits_of(reach), count, stop_after)
    return [Foothold(x, y, yaw, stance.z) for x, y, yaw in poses[1:].tolist()]


def preview_poses(
    stance: Foothold,
    foot: int,
    velocity: Velocity,
    period: float,
    limits: Limits,
    count: int,
    stop_after: int | None = None,
) -> Matrix:
    """``preview_footholds`` below the stance, each x, y [m] and heading [rad] in W (1 + steps, 3)."""
    if stop_after is not None:
        count = max(min(count, stop_after), 1)
        velocity = (0.0, 0.0, 0.0)
    poses: Matrix = preview(stance.pose, foot, advance_of(velocity, period), limits, count)
    return poses
