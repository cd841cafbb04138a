"""What one key pose asks for, with every number resolved for one robot: metres, radians, base_footprint."""

from __future__ import annotations

from dataclasses import dataclass, field

import pinocchio as pin

from models.types import Matrix, Vector

TARGET_FRAMES = ("base_link", "torso", "gaze", "l_wrist", "r_wrist")
"""Frames that a motion may move (REP-120 names); the soles stay planted."""


@dataclass(frozen=True, slots=True)
class FrameGoal:
    """Where one frame should be.

    Attributes:
        frame: One of ``TARGET_FRAMES``.
        position: Origin in base_footprint (3,) [m], or None when it is free.
        axes: Axes of base_footprint along which ``position`` counts, such as 'xyz' or 'z'.
        rotation: Orientation in base_footprint (3, 3), or None when it is free.
    """

    frame: str
    position: Vector | None
    axes: str
    rotation: Matrix | None


@dataclass(frozen=True, slots=True)
class PoseGoal:
    """One key pose.

    Attributes:
        name: What to call it in an error message.
        frames: Frames with a target of their own.
        posture: Joint positions that the joints tend to (nj,) [rad].
        com: Place over which the CoM tends to be, in base_footprint (2,) [m].
        base: Pose that base_link tends to; of its position only the height counts.
        torso: Orientation that the torso tends to (3, 3).
        joints: Joints with a target of their own: index in a joint vector to position [rad].
    """

    name: str
    frames: tuple[FrameGoal, ...]
    posture: Vector
    com: Vector
    base: pin.SE3
    torso: Matrix
    joints: dict[int, float] = field(default_factory=dict)
