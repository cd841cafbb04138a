"""Foot: sole, joints of the leg, and the area in which they can hold the CoP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from models.errors import RobotModelError
from models.types import Matrix, Vector

LENGTH, WIDTH, NORMAL = range(3)  #: Axes of a sole, for rotation by a joint or a contact
_HEIGHT = 0.25  #: Maximum height of an ankle joint above the sole, over the length of the leg [-]
_ALIGNED = 0.7  #: Minimum cosine between the axis of an ankle joint and the nearest axis of the sole [-]
_RANK = 0.01  #: Rank tolerance: minimum singular value of a leg's Jacobian, lengths in leg lengths [-]


class AnkleJoint(NamedTuple):
    """A joint of the ankle."""

    index_v: int  #: Index of the joint; for a ``Foot``, index into v
    axis: int  #: Axis of the sole about which the joint turns it, ``LENGTH`` or ``WIDTH``
    positive: bool  #: Whether positive joint motion turns the sole positively about that axis


@dataclass(frozen=True, slots=True)
class Foot:
    """One foot."""

    name: str  #: 'left' or 'right'
    link: str  #: Link of the URDF with the sole
    frame_id: int  #: Pinocchio frame of the sole: origin in the sole plane, x forward, z up
    rectangle: tuple[float, float, float, float]  #: Contact rectangle x_min, x_max, y_min, y_max in the sole frame [m]
    friction: float  #: Nominal Coulomb coefficient of sole on floor, without the margin of a controller [-]
    joint_ids_v: tuple[int, ...]  #: Indices into v of the joints that move only this foot, from hip to foot
    chain_ids_v: tuple[int, ...]  #: Indices into v of all joints between base and foot
    ankle: tuple[AnkleJoint, ...]  #: Joints that turn the sole under the leg
    free: tuple[bool, bool, bool]  #: Axes about which the leg turns the planted sole; see ``leg_freedoms``
    bearing: tuple[float, float, float, float]  #: Part of the rectangle in which the leg can hold the CoP [m]

    @property
    def corners(self) -> Matrix:
        """Corners of the contact rectangle in the sole frame, counter-clockwise from front left (4, 3) [m]."""
        return corners_of(self.rectangle)


def ankle_joints(columns: Matrix, indices: Sequence[int], heights: Sequence[float], leg: float) -> list[AnkleJoint]:
    """Ankle joints among the joints of a leg.

    ``columns`` (6, n) are the columns of the sole's Jacobian in the sole frame, ``indices`` (n,) the joints,
    ``heights`` (n,) their heights above the sole [m], and ``leg`` the height of the hip above the sole [m].
    """
    found = []
    for column, index, height in zip(columns.T, indices, heights, strict=True):
        axis = int(np.abs(column[3:5]).argmax())
        if height <= _HEIGHT * leg and abs(column[3 + axis]) > _ALIGNED:
            found.append(AnkleJoint(index, axis, bool(column[3 + axis] > 0.0)))
    return found


def leg_freedoms(columns: Matrix, leg: float) -> tuple[bool, bool, bool]:
    """Axes of the sole (length, width, normal) about which a planted sole turns with the leg.

    The leg moves the sole in as many directions as the rank of the Jacobian ``columns`` (6, n), in the sole frame.
    Below rank 6 the contact leaves a rotation free: about the length of the sole, as on an edge, then about its normal.
    ``leg`` is the height of the hip above the sole [m]. Raises ``RobotModelError`` if the rank stays below 6.
    """
    reach, free = np.array(columns, dtype=float), [False, False, False]
    reach[:3] /= leg
    for axis in (None, LENGTH, NORMAL):
        more = reach if axis is None else np.column_stack((reach, np.eye(6)[3 + axis]))
        if axis is not None and (rank := _rank(more)) > _rank(reach):
            free[axis], reach = True, more
        if (rank := _rank(reach)) == 6:
            return free[0], free[1], free[2]
    raise RobotModelError(
        f"{columns.shape[1]} joints, which move the base above a planted foot in {rank} of 6 directions, even where it "
        "turns about its length and its normal"
    )


def _rank(columns: Matrix) -> int:
    return int((np.linalg.svd(columns, compute_uv=False) > _RANK).sum())


def bearing_area(
    rectangle: Sequence[float],
    ankle: Sequence[AnkleJoint],
    columns: Matrix,
    gravity: Vector,
    limits: Vector,
    force: float,
    *,
    rolls: bool,
) -> tuple[float, float, float, float]:
    r"""Part of a sole in which the ankle can hold the CoP under a normal force N (``force``) [N].

    .. math:: |g_j - N (J_{z} + y J_{rx} - x J_{ry})| \le \tau_{max}

    for the joints j of the ``ankle``, with the Jacobian of the sole ``columns`` (6, nv), ``gravity`` (nv,) [N.m] and
    ``limits`` (nv,) [N.m]. The area is the nearest line if a joint holds it nowhere, the middle line if it ``rolls``.
    """
    sides = [list(rectangle[:2]), list(rectangle[2:])]
    for joint in ankle:
        column, rest, limit = columns[:, joint.index_v], float(gravity[joint.index_v]), float(limits[joint.index_v])
        lever = force * float(column[4] if joint.axis == WIDTH else -column[3])
        held = sorted((force * float(column[2]) - rest + sign * limit) / lever for sign in (-1.0, 1.0))
        side = sides[1 - joint.axis]
        side[:] = np.clip(np.array(held), side[0], side[1]).tolist()
    (x_min, x_max), (y_min, y_max) = sides[0], sides[1]
    middle = 0.5 * (y_min + y_max)
    return (x_min, x_max, middle, middle) if rolls else (x_min, x_max, y_min, y_max)


def within(area: Sequence[float], bounds: Sequence[float]) -> tuple[float, float, float, float]:
    """Intersection of two rectangles [m]; along an axis without overlap, the interval of ``area``."""
    x_min, x_max = _within(area[0], area[1], bounds[0], bounds[1])
    y_min, y_max = _within(area[2], area[3], bounds[2], bounds[3])
    return x_min, x_max, y_min, y_max


def _within(low: float, high: float, least: float, most: float) -> tuple[float, float]:
    inside = max(low, least), min(high, most)
    return inside if inside[0] <= inside[1] else (low, high)


def corners_of(rectangle: Sequence[float]) -> Matrix:
    """Corners (4, 3) [m] of a rectangle (x_min, x_max, y_min, y_max) [m], counter-clockwise from front left."""
    x_min, x_max, y_min, y_max = rectangle
    return np.array([[x_max, y_max, 0.0], [x_min, y_max, 0.0], [x_min, y_min, 0.0], [x_max, y_min, 0.0]])
