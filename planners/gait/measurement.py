"""Measurement of CoM, DCM and soles from a robot state."""

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from msgspec import Struct
from numpy.typing import NDArray

from models.constants import GRAVITY
from models.numerics.compiled import njit, register_jitable
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import Matrix, RobotState, Vector
from planners.gait.footsteps import Feet, Foothold, Place, Point

Array = NDArray[np.float64]

#: Least cosine of the tilt of a sole in the computation of its slope [-]; the slope of an upturned foot is meaningless
_UPRIGHT_MIN = 0.1
LOADED = 0.05  #: Share of the weight on a sole above which it has a centre of pressure [-]


class Measurement(Struct, frozen=True):
    """CoM, DCM and soles of one robot state."""

    com: Vector  # in W (3,) [m]
    com_velocity: Vector  # in W (3,) [m/s]
    soles: Feet
    tilts: Matrix  # slope of each sole: rise along x and along y of W (2, 2) [-]
    turning: Matrix  # angular velocity of each sole about its x and y (2, 2) [rad/s]
    cops: Matrix  # CoP in the frame of each sole; without load, the CoP of the last tick with load (2, 2) [m]
    loads: tuple[float, float]  # force along the normal of each sole, share of the weight [-]
    active: tuple[bool, bool]  # estimated contact of each foot
    forces: Matrix  # force on each sole in W, share of the weight (2, 3) [-]

    def upright(self, foot: int) -> bool:
        """Whether the force on a sole is within 45 degrees of the vertical; False without a force."""
        return bool(points_up(self.forces[foot]))

    def dcm(self, omega: float) -> Vector:
        """``xi = c + c' / omega``, horizontal (2,) [m]."""
        dcm: Vector = self.com[:2] + self.com_velocity[:2] / omega
        return dcm


@register_jitable
def points_up(force: Vector) -> bool:
    """Whether a force (3,) is within 45 degrees of the vertical, so from ground below and not the side of an edge."""
    return bool(force[2] > 0.0 and force[2] * force[2] >= force[0] * force[0] + force[1] * force[1])


@njit(cache=True)
def filtered_dcm_rate(
    rate: Vector, com_before: Vector, velocity_before: Vector, com: Vector, velocity: Vector, omega: float, dt: float,
    share: float, after: Vector,
) -> None:  # fmt: skip
    """Fill the DCM rate (2,) [m/s], low-passed by ``share``, from the last rate and two states ``dt`` [s] apart."""
    for i in range(2):
        way = com[i] + velocity[i] / omega - (com_before[i] + velocity_before[i] / omega)
        after[i] = rate[i] + share * (way / dt - rate[i])


class BodyMotion(NamedTuple):
    """CoM and soles of one robot state, for compiled code."""

    com: Vector  # in W (3,) [m]
    com_velocity: Vector  # in W (3,) [m/s]
    poses: Array  # of the soles in W, homogeneous (2, 4, 4)
    twists: Matrix  # of the soles, each in its frame, linear part first (2, 6) [m/s, rad/s]


class Ground(NamedTuple):
    """Contact areas and slope of the ground."""

    areas: Matrix  # bearing rectangle of each sole; without width, the sole stands on an edge (2, 4) [m]
    slope: Vector  # expected (2,) [-]


class _Rims(NamedTuple):
    """Constants of ``GaitMeasurement``."""

    whole: Matrix  # rectangles of the soles (2, 4) [m]
    lie: float  # slope by which a sole on its rim is turned towards the ground [-]


class GaitMeasurement:
    """Evaluates robot states.

    The place of a sole on an edge is where it would lie if turned flat about that edge. On an edge across the sole, its
    tilt is the expected slope. On its rim, its tilt is the present one turned towards the ground by ``lie_angle``
    [rad]. The reference of a sole follows its measured tilt, so the sole lies down.
    """

    def __init__(self, model: RobotModel, lie_angle: float = 0.0) -> None:
        self._model, self._data = model, model.data()
        self._weight = model.mass * GRAVITY
        self._motion = BodyMotion(np.zeros(3), np.zeros(3), np.zeros((2, 4, 4)), np.zeros((2, 6)))
        self._unboxed = unbox(self._motion)
        self._whole = Ground(np.array([foot.rectangle for foot in model.feet]), np.zeros(2))
        self._rims = unbox(_Rims(self._whole.areas, math.tan(lie_angle)))

    def measure(
        self,
        state: RobotState,
        last: Measurement | None = None,
        motion: Unboxed[BodyMotion] | None = None,
        ground: Ground | None = None,
    ) -> Measurement:
        """Evaluate a state; ``last`` provides the centres of pressure of soles without load.

        ``motion`` is CoM and soles of the same ``state``, computed from it when None. ``ground`` is the ground of the
        last tick; level and with whole soles when None.
        """
        areas, slope = ground or self._whole
        if motion is None:
            self._move(state)
            motion = self._unboxed
        body, tilts, turning, forces = np.empty((2, 3)), np.empty((2, 2)), np.empty((2, 2)), np.empty((2, 3))
        cops = np.zeros((2, 2)) if last is None else last.cops.copy()
        left, right = state.contacts
        wrenches = left.wrench, right.wrench
        first, second, loads = _measure(
            motion, *wrenches, self._weight, areas, slope, self._rims, body, tilts, turning, cops, forces
        )
        return Measurement(
            com=body[0],
            com_velocity=body[1],
            soles=(Foothold(*first), Foothold(*second)),
            tilts=tilts,
            turning=turning,
            cops=cops,
            loads=loads,
            active=(left.active, right.active),
            forces=forces,
        )

    def _move(self, state: RobotState) -> None:
        model, data, motion = self._model, self._data, self._motion
        pin.centerOfMass(model.pin, data, state.q, state.v, False)
        motion.com[:], motion.com_velocity[:] = data.com[0], data.vcom[0]
        for foot, pose, twist in zip(model.feet, motion.poses, motion.twists, strict=True):
            pose[:] = pin.updateFramePlacement(model.pin, data, foot.frame_id).homogeneous
            twist[:] = pin.getFrameVelocity(model.pin, data, foot.frame_id, pin.LOCAL).vector


@njit(cache=True)
def _measure(
    motion: Unboxed[BodyMotion],
    left: Vector,
    right: Vector,
    weight: float,
    areas: Matrix,
    slope: Vector,
    constants: Unboxed[_Rims],
    body: Matrix,
    tilts: Matrix,
    turning: Matrix,
    cops: Matrix,
    forces: Matrix,
) -> tuple[Place, Place, Point]:
    """Place of each sole, and its load as a share of the ``weight`` [N].

    Fills the fields ``tilts``, ``turning``, ``cops`` and ``forces`` of ``Measurement``, and ``body``: CoM and its
    velocity (2, 3).
    """
    com, velocity, poses, twists = motion.record
    rims = constants.record
    pivots = np.zeros((2, 2))
    for i in range(3):
        body[0, i], body[1, i] = com[i], velocity[i]
    for foot in range(2):
        pose, wrench = poses[foot], left if foot == 0 else right
        upright = max(pose[2, 2], _UPRIGHT_MIN)
        for i in range(3):
            forces[foot, i] = (pose[i, 0] * wrench[0] + pose[i, 1] * wrench[1] + pose[i, 2] * wrench[2]) / weight
        for i in range(2):
            tilts[foot, i] = -pose[i, 2] / upright
            turning[foot, i] = twists[foot, 3 + i]
            if areas[foot, 2 * i] == areas[foot, 2 * i + 1]:
                pivots[foot, i] = areas[foot, 2 * i]
        if areas[foot, 0] == areas[foot, 1] or areas[foot, 2] == areas[foot, 3]:
            along = _lie_down(pivots[foot, 0], rims.whole[foot, 0], rims.whole[foot, 1], rims.lie)
            across = _lie_down(pivots[foot, 1], rims.whole[foot, 2], rims.whole[foot, 3], rims.lie)
            if along == 0.0 and across == 0.0:
                tilts[foot] = slope
            yaw = math.atan2(pose[1, 0], pose[0, 0])
            tilts[foot, 0] += math.cos(yaw) * along - math.sin(yaw) * across
            tilts[foot, 1] += math.sin(yaw) * along + math.cos(yaw) * across
        if wrench[2] / weight > LOADED:
            cops[foot, 0], cops[foot, 1] = -wrench[4] / wrench[2], wrench[3] / wrench[2]
    return _place(poses[0], pivots[0]), _place(poses[1], pivots[1]), (left[2] / weight, right[2] / weight)


@register_jitable
def _lie_down(pivot: float, low: float, high: float, lie: float) -> float:
    """Change of slope along an axis that lowers a sole from its rim; negative on the low rim."""
    return -lie if pivot == low else lie if pivot == high else 0.0


@register_jitable
def _place(pose: Matrix, pivot: Vector) -> Place:
    """Place of a sole that lies level on its pivot (2,) [m]."""
    yaw, (px, py) = math.atan2(pose[1, 0], pose[0, 0]), pivot
    if px == 0.0 and py == 0.0:
        return pose[0, 3], pose[1, 3], yaw, pose[2, 3]
    c, s = math.cos(yaw), math.sin(yaw)
    return (
        pose[0, 3] + pose[0, 0] * px + pose[0, 1] * py - (c * px - s * py),
        pose[1, 3] + pose[1, 0] * px + pose[1, 1] * py - (s * px + c * py),
        yaw,
        pose[2, 3] + pose[2, 0] * px + pose[2, 1] * py,
    )
