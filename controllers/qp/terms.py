"""Model terms of one tick, updated once and shared by tasks, limits, contacts and laws."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from models.constants import GRAVITY
from models.errors import ConfigError
from models.numerics.compiled import njit
from models.numerics.so3 import exponential, multiply, quaternion_matrix, rotation_error
from models.numerics.unboxed import Unboxed, unbox
from models.robot_model import RobotModel
from models.types import Matrix, RobotState, Vector
from planners.gait.measurement import BodyMotion

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_WORLD = pin.Convention.WORLD

TORSO, BASE = 2, 3  #: Indices of frames in the arrays of ``Dynamics``; the soles are 0 and 1
FIRST_FRAMES = ("l_sole", "r_sole", "torso", "base_link")  #: Frames of every robot, by index


class FrameTerms(NamedTuple):
    """Terms of a frame F, expressed in F except the pose, linear part first."""

    pose: Matrix  #: Homogeneous transform in W (4, 4)
    jacobian: Matrix  #: J_F (6, nv)
    twist: Vector  #: Velocity (6,) [m/s, rad/s]
    drift: Vector  #: Classical acceleration at zero generalised acceleration (6,) [m/s^2, rad/s^2]

    @property
    def rotation(self) -> Matrix:
        """Rotation of F in W, a view of the pose (3, 3)."""
        return self.pose[:3, :3]

    @property
    def position(self) -> Vector:
        """Origin of F in W, a view of the pose (3,) [m]."""
        return self.pose[:3, 3]


class Dynamics(NamedTuple):
    """Dynamics and frames for compiled code; see ``Terms``. The first axis of the frame arrays is the frame."""

    q: Array
    v: Array
    mass_matrix: Array
    bias: Array
    poses: Array
    jacobians: Array
    twists: Array
    drifts: Array


class Centroid(NamedTuple):
    """CoM and centroidal angular momentum; see ``Terms``."""

    base_rotation: Array
    com: Array
    com_velocity: Array
    com_jacobian: Array
    com_drift: Array
    momentum: Array
    momentum_matrix: Array
    momentum_drift: Array


class _Tree(NamedTuple):
    """Inputs of the frame terms: Pinocchio's arrays of all joints, and joint and placement of each frame."""

    jacobian: Array  #: (6, nv), world axes, linear part at the world's origin
    rotations: Array  #: (joints, 3, 3), in W
    positions: Array  #: (joints, 3), in W
    linear: Array  #: (joints, 3), acceleration at zero generalised acceleration minus gravity, in the joint
    angular: Array  #: (joints, 3)
    parents: Index  #: (frames,)
    placements: Array  #: (frames, 3, 4), in the parent joint
    columns: Index  #: (frames, nv), velocity indices that move the frame, padded with -1


class ModelTerms(NamedTuple):
    """All terms for compiled code, and the inputs of the frame terms."""

    dynamics: Dynamics
    centroid: Centroid
    tree: _Tree
    mass: float


class Terms:
    """Dynamics, centroidal quantities and frames of the current state.

    ``update`` overwrites the arrays in place; Pinocchio owns the arrays of the dynamics. Frame terms are computed from
    the Jacobian, placements and accelerations of the joints, which are results of ``crba`` and ``nonLinearEffects``, so
    an additional frame requires no further pass over the tree.

    ``frames`` are names of further frames, of the profile or the URDF. Raises ``ConfigError`` for an unknown name.
    """

    def __init__(self, model: RobotModel, frames: Sequence[str] = ()) -> None:
        self._pin = robot = model.pin
        self._data = data = model.data()
        nv = model.nv
        ids = dict(zip(FIRST_FRAMES, [foot.frame_id for foot in model.feet], strict=False))
        ids |= {name: frame_id_of(model, name) for name in (*FIRST_FRAMES[len(ids) :], *frames)}
        count = len(ids)
        self.q, self.v = np.zeros(model.nq), np.zeros(nv)
        # Pinocchio does not reallocate these arrays. M is symmetric, and its transpose has contiguous rows.
        self.mass_matrix: Matrix = data.M.T  #: M with rotor inertia (nv, nv)
        self.bias: Vector = data.nle  #: Coriolis and gravity (nv,)
        self.joint_jacobian: Matrix = data.J  #: Jacobian of all joints in W, linear part at the origin of W (6, nv)
        self.base_rotation = np.eye(3)  #: R_WB (3, 3)
        #: In W [m, m/s, m/s^2]; ``momentum`` is angular, about the CoM; drifts are rates at zero acceleration
        self.com, self.com_velocity, self.com_drift = np.zeros(3), np.zeros(3), np.zeros(3)
        self.momentum, self.momentum_drift = np.zeros(3), np.zeros(3)
        self.com_jacobian, self.momentum_matrix = np.zeros((3, nv)), np.zeros((3, nv))
        poses, jacobians = np.tile(np.eye(4), (count, 1, 1)), np.zeros((count, 6, nv))
        twists, drifts = np.zeros((count, 6)), np.zeros((count, 6))
        self.dynamics = Dynamics(self.q, self.v, self.mass_matrix, self.bias, poses, jacobians, twists, drifts)
        self.centroid = centroid = Centroid(
            self.base_rotation,
            self.com,
            self.com_velocity,
            self.com_jacobian,
            self.com_drift,
            self.momentum,
            self.momentum_matrix,
            self.momentum_drift,
        )
        self.frames = {name: FrameTerms(poses[k], jacobians[k], twists[k], drifts[k]) for k, name in enumerate(ids)}
        self.soles = self.frames["l_sole"], self.frames["r_sole"]  #: Left and right sole
        self.torso = self.frames["torso"]  #: Torso frame
        parents = [robot.frames[frame].parentJoint for frame in ids.values()]
        tree = _Tree(
            data.J,
            *_placement_views(data.oMi),
            *_motion_views(data.a_gf),
            np.array(parents, dtype=np.int64),
            np.array([robot.frames[frame].placement.homogeneous[:3] for frame in ids.values()]),
            _columns(robot, parents),
        )
        self.unboxed = unbox(ModelTerms(self.dynamics, centroid, tree, model.mass))  #: All terms, for compiled code
        motion = BodyMotion(self.com, self.com_velocity, poses[: len(model.feet)], twists[: len(model.feet)])
        self.motion = unbox(motion)  #: Motion of CoM and soles, for a gait

    def update(self, state: RobotState) -> None:
        """Evaluate all terms at a state and overwrite the arrays of this object."""
        self.q[:] = state.q
        self.v[:] = state.v
        self.call_pinocchio()
        _update(self.unboxed)

    def call_pinocchio(self) -> None:
        """Run only the Pinocchio algorithms of ``update``; used by the benchmark."""
        pin.crba(self._pin, self._data, self.q, _WORLD)  # also J and the placements of the joints
        pin.nonLinearEffects(self._pin, self._data, self.q, self.v)  # also the accelerations of the bodies at zero a

    def place(self, geometry: pin.GeometryModel, data: pin.GeometryData) -> None:
        """Update the placements of shapes from the placements of the joints."""
        pin.updateGeometryPlacements(self._pin, self._data, geometry, data)


def frame_id_of(model: RobotModel, name: str) -> int:
    """Pinocchio's id of a frame by its name in the profile, or in the URDF; ``ConfigError`` for an unknown name."""
    try:
        return model.frame_id(name)
    except ConfigError as error:
        found = [index for index, frame in enumerate(model.pin.frames) if frame.name == name]
        if not found:
            raise ConfigError(f"{error}; the URDF has no frame of that name either") from error
        return found[-1]  # the frame of a link comes after the frame of its joint


def _placement_views(placements: pin.StdVec_SE3) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) and translations (n, 3) [m] of a C++ vector of poses, as views of its memory."""
    first, second = placements[0], placements[1]
    step = _stride(first.rotation, second.rotation)
    rotation, count = first.rotation, len(placements)
    return (
        as_strided(rotation, (count, 3, 3), (step, *rotation.strides)),
        as_strided(first.translation, (count, 3), (step, 8)),
    )


def _motion_views(motions: pin.StdVec_Motion) -> tuple[Array, Array]:
    """Linear and angular parts (n, 3) of a C++ vector of motions, as views of its memory."""
    first, second = motions[0], motions[1]
    step, count = _stride(first.linear, second.linear), len(motions)
    return as_strided(first.linear, (count, 3), (step, 8)), as_strided(first.angular, (count, 3), (step, 8))


def _stride(first: Array, second: Array) -> int:
    """Distance of two adjacent elements in memory [bytes]."""
    return int(second.__array_interface__["data"][0] - first.__array_interface__["data"][0])


def _columns(robot: pin.Model, parents: Sequence[int]) -> Index:
    """Velocity indices of the joints that move each frame, padded with -1 (frames, nv)."""
    columns = np.full((len(parents), robot.nv), -1, dtype=np.int64)
    for row, parent in zip(columns, parents, strict=True):
        joint, used = parent, 0
        while joint > 0:
            first, count = robot.idx_vs[joint], robot.nvs[joint]
            row[used : used + count] = np.arange(first, first + count)
            joint, used = robot.parents[joint], used + count
    return columns


@njit(cache=True)
def finite_state(q: Array, v: Array) -> bool:
    """Whether a configuration (nq,) and a velocity (nv,) are finite."""
    total = 0.0
    for i in range(q.shape[0]):
        total += q[i]
    for i in range(v.shape[0]):
        total += v[i]
    return bool(np.isfinite(total))


@njit(cache=True)
def _update(model: Unboxed[ModelTerms]) -> None:
    """Compute all terms from the results of Pinocchio for ``q`` and ``v``."""
    dynamics, centroid, tree = model.record.dynamics, model.record.centroid, model.record.tree
    quaternion_matrix(dynamics.q[3:7], centroid.base_rotation)
    _centroidal_terms(dynamics, centroid, model.record.mass, GRAVITY)
    for frame in range(tree.parents.shape[0]):
        _frame_terms(dynamics, tree, frame, GRAVITY)


@njit(cache=True, forceinline=True)
def frame_of(dynamics: Dynamics, frame: int) -> FrameTerms:
    """Terms of one frame by its index."""
    return FrameTerms(dynamics.poses[frame], dynamics.jacobians[frame], dynamics.twists[frame], dynamics.drifts[frame])


@njit(cache=True, forceinline=True)
def _frame_terms(terms: Dynamics, tree: _Tree, frame: int, gravity: float) -> None:
    """Pose, Jacobian, twist and drift of one frame.

    ``A`` is the spatial acceleration of the joint that moves the frame, at zero generalised acceleration and with
    gravity as an upward acceleration of the base, as computed by ``nonLinearEffects``; all in the frame::

        drift = X^-1 A + (w x v, 0) - (R' g, 0)
    """
    joint, offset = tree.parents[frame], tree.placements[frame]
    pose, jacobian = terms.poses[frame], terms.jacobians[frame]
    twist, drift = terms.twists[frame], terms.drifts[frame]
    for i in range(3):
        pose[i, 3] = tree.positions[joint, i]
        for j in range(3):
            pose[i, j] = 0.0
            for k in range(3):
                pose[i, j] += tree.rotations[joint, i, k] * offset[k, j]
            pose[i, 3] += tree.rotations[joint, i, j] * offset[j, 3]
    px, py, pz = pose[0, 3], pose[1, 3], pose[2, 3]
    twist[:] = 0.0
    for column in tree.columns[frame]:
        if column < 0:
            break
        ax = tree.jacobian[3, column]
        ay = tree.jacobian[4, column]
        az = tree.jacobian[5, column]
        lx = tree.jacobian[0, column] + ay * pz - az * py
        ly = tree.jacobian[1, column] + az * px - ax * pz
        lz = tree.jacobian[2, column] + ax * py - ay * px
        rate = terms.v[column]
        for row in range(3):
            r0, r1, r2 = pose[0, row], pose[1, row], pose[2, row]
            up = r0 * lx + r1 * ly + r2 * lz
            turn = r0 * ax + r1 * ay + r2 * az
            jacobian[row, column] = up
            jacobian[3 + row, column] = turn
            twist[row] += up * rate
            twist[3 + row] += turn * rate
    # Acceleration at the origin of the frame, in the axes of the joint: a + alpha x p.
    linear, angular = tree.linear[joint], tree.angular[joint]
    cx = linear[0] + angular[1] * offset[2, 3] - angular[2] * offset[1, 3]
    cy = linear[1] + angular[2] * offset[0, 3] - angular[0] * offset[2, 3]
    cz = linear[2] + angular[0] * offset[1, 3] - angular[1] * offset[0, 3]
    for row in range(3):
        drift[row] = offset[0, row] * cx + offset[1, row] * cy + offset[2, row] * cz - pose[2, row] * gravity
        drift[3 + row] = offset[0, row] * angular[0] + offset[1, row] * angular[1] + offset[2, row] * angular[2]
    drift[0] += twist[4] * twist[2] - twist[5] * twist[1]
    drift[1] += twist[5] * twist[0] - twist[3] * twist[2]
    drift[2] += twist[3] * twist[1] - twist[4] * twist[0]


@njit(cache=True, forceinline=True)
def _centroidal_terms(terms: Dynamics, out: Centroid, mass: float, gravity: float) -> None:
    """CoM and centroidal angular momentum from the free-flyer rows of the dynamics.

    The contact force and moment at the base origin in B are ``f = M[:3] a + h[:3]`` and ``n = M[3:6] a + h[3:6]``::

        c'' = R f / m + g,    L' = R (n - c_B x f)
    """
    matrix, rotation = terms.mass_matrix, out.base_rotation
    nv = terms.v.shape[0]
    cx = matrix[1, 5] / mass
    cy = -matrix[0, 5] / mass
    cz = matrix[0, 4] / mass
    for i in range(3):
        out.com[i] = terms.q[i] + rotation[i, 0] * cx + rotation[i, 1] * cy + rotation[i, 2] * cz
        out.com_velocity[i] = 0.0
        out.momentum[i] = 0.0
    for j in range(nv + 1):
        if j < nv:
            fx, fy, fz = matrix[0, j], matrix[1, j], matrix[2, j]
            nx, ny, nz = matrix[3, j], matrix[4, j], matrix[5, j]
        else:
            fx, fy, fz = terms.bias[0], terms.bias[1], terms.bias[2]
            nx, ny, nz = terms.bias[3], terms.bias[4], terms.bias[5]
        nx -= cy * fz - cz * fy
        ny -= cz * fx - cx * fz
        nz -= cx * fy - cy * fx
        for i in range(3):
            linear = (rotation[i, 0] * fx + rotation[i, 1] * fy + rotation[i, 2] * fz) / mass
            angular = rotation[i, 0] * nx + rotation[i, 1] * ny + rotation[i, 2] * nz
            if j < nv:
                out.com_jacobian[i, j] = linear
                out.momentum_matrix[i, j] = angular
                out.com_velocity[i] += linear * terms.v[j]
                out.momentum[i] += angular * terms.v[j]
            else:
                out.com_drift[i] = linear
                out.momentum_drift[i] = angular
    out.com_drift[2] -= gravity


@njit(cache=True)
def pose_error(pose: Array, rotation: Array, position: Array, out: Array) -> None:
    """Position and rotation error (6,) of a pose (4, 4) from a rotation (3, 3) and origin (3,), in the pose's frame."""
    for i in range(3):
        total = 0.0
        for k in range(3):
            total += pose[k, i] * (position[k] - pose[k, 3])
        out[i] = total
    rotation_error(pose, rotation, out[3:])


@njit(cache=True)
def follow_pose(rotation: Array, position: Array, pose: Array, share: float) -> None:
    """Move a rotation (3, 3) and position (3,) in place towards a pose (4, 4), by a share of the distance [-]."""
    turn, step, old = np.zeros(3), np.empty((3, 3)), rotation.copy()
    rotation_error(rotation, pose, turn)
    for i in range(3):
        turn[i] *= share
        position[i] += share * (pose[i, 3] - position[i])
    exponential(turn, step)
    multiply(old, step, rotation)
