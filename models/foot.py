"""A foot: its sole, the joints of its leg, and what they can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from models.errors import RobotModelError
from models.types import Matrix, Vector

LENGTH, WIDTH, NORMAL = range(3)  #: Axes of a sole that a joint or a contact turns about
_HEIGHT = 0.25  #: Joints lower than this share of the leg above the sole are the ankle's [-]
_ALIGNED = 0.7  #: Least cosine between the axis of such a joint and that of the sole that it turns about [-]
_RANK = 0.01  #: Singular value of a leg's Jacobian, with lengths in legs, below which it moves the sole no further [-]


class AnkleJoint(NamedTuple):
    """A joint of the ankle."""

    index_v: int  #: Index of the joint, into v for a ``Foot``
    axis: int  #: Of the sole that it turns about, ``LENGTH`` or ``WIDTH``
    positive: bool  #: Whether the sole turns about that axis in the joint's positive sense


@dataclass(frozen=True, slots=True)
class Foot:
    """One foot."""

    name: str  #: 'left' or 'right'
    link: str  #: Link of the URDF with the sole
    frame_id: int  #: Pinocchio frame of the sole: origin in the sole plane, x forward, z up
    rectangle: tuple[float, float, float, float]  #: Contact rectangle x_min, x_max, y_min, y_max in the sole frame [m]
    friction: float  #: Nominal Coulomb coefficient of sole on floor [-]; a controller applies its margin
    joint_ids_v: tuple[int, ...]  #: Indices into v of the leg's joints, from hip to foot; no other foot moves with them
    chain_ids_v: tuple[int, ...]  #: The same of all joints between base and foot
    ankle: tuple[AnkleJoint, ...]  #: Joints that turn the sole under the leg
    free: tuple[bool, bool, bool]  #: Axes of the sole about which it turns with the leg, see ``leg_freedoms``
    bearing: tuple[float, float, float, float]  #: Part of the rectangle in which the leg can hold the CoP [m]

    @property
    def corners(self) -> Matrix:
        """Corners of the contact rectangle in the sole frame, counter-clockwise from front left (4, 3) [m]."""
        return corners_of(self.rectangle)


def ankle_joints(columns: Matrix, indices: Sequence[int], heights: Sequence[float], leg: float) -> list[AnkleJoint]:
    """Joints of an ankle among those of a leg.

    ``columns`` are those of the sole's Jacobian in its frame (6, n), ``indices`` theirs, ``heights`` of the joints
    above the sole [m], ``leg`` that of the hip.
    """
    found = []
    for column, index, height in zip(columns.T, indices, heights, strict=True):
        axis = int(np.abs(column[3:5]).argmax())
        if height <= _HEIGHT * leg and abs(column[3 + axis]) > _ALIGNED:
            found.append(AnkleJoint(index, axis, bool(column[3 + axis] > 0.0)))
    return found


def leg_freedoms(columns: Matrix, leg: float) -> tuple[bool, bool, bool]:
    """Axes of the sole, length, width and normal, about which a planted sole turns with the leg.

    A leg moves its sole in as many directions as its Jacobian (6, n), in the frame of the sole, has rank. A contact
    with the ground makes up for those that are missing: the sole may turn about its length, as on an edge, else about
    its normal. ``leg`` is the height of the hip above the sole [m]. Raises ``RobotModelError`` where neither helps.
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
    r"""Part of a sole in which the ankle can hold the CoP under a normal force N.

    .. math:: |g_j - N (J_{z} + y J_{rx} - x J_{ry})| \le \tau_{max}

    for the joints j of the ``ankle``, with ``columns`` of the sole's Jacobian (6, nv), ``gravity`` (nv,) and ``limits``
    (nv,) [N.m]; where a joint cannot hold it anywhere, the nearest line. Of a sole that ``rolls`` the middle line.
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
    """The part of a rectangle in another; along an axis where they do not meet, that of ``area`` [m]."""
    x_min, x_max = _within(area[0], area[1], bounds[0], bounds[1])
    y_min, y_max = _within(area[2], area[3], bounds[2], bounds[3])
    return x_min, x_max, y_min, y_max


def _within(low: float, high: float, least: float, most: float) -> tuple[float, float]:
    inside = max(low, least), min(high, most)
    return inside if inside[0] <= inside[1] else (low, high)


def corners_of(rectangle: Sequence[float]) -> Matrix:
    """Corners of x_min, x_max, y_min, y_max [m] in a sole frame, counter-clockwise from front left (4, 3) [m]."""
    x_min, x_max, y_min, y_max = rectangle
    return np.array([[x_max, y_max, 0.0], [x_min, y_max, 0.0], [x_min, y_min, 0.0], [x_max, y_min, 0.0]])
