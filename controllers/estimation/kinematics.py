"""Sole poses relative to the IMU, and pose, twist and covariance of the base from those of the IMU."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.estimation.filter_kernels import GYRO_BIAS, POSITION, ROTATION, VELOCITY, SolePoses
from models.errors import RobotModelError
from models.numerics.compiled import njit
from models.numerics.so3 import rotate, rotate_transposed, to_quaternion
from models.robot_model import RobotModel
from models.tree import KinematicTree, TreeFrames, place_bodies, place_frame, read_frames, read_tree
from models.types import Vector

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class ImuPose(NamedTuple):
    """Pose of the IMU in the base frame."""

    rotation: Array  # R_BI (3, 3)
    position: Array  # (3,) [m]
    jacobian: Array  # local Jacobian (6, k); k = 0 if the IMU is on the base
    columns: Index  # joints between base and IMU (k,)


class PoseVariances(NamedTuple):
    """Variances of a joint position [rad^2] and of model errors of a sole's position [m^2] and orientation [rad^2]."""

    encoder: float
    position: float
    orientation: float


class SoleChains(NamedTuple):
    """Chains to soles and IMU, and the resulting poses."""

    tree: KinematicTree
    frames: TreeFrames  # left sole, right sole, IMU
    columns: Index  # joints between base and each sole, padded with -1 (2, k)
    variances: PoseVariances
    imu: ImuPose
    soles: SolePoses


class SoleKinematics:
    """Kinematic measurement of the filter; a test compares it with Pinocchio.

    ``imu`` is in the base frame, ``soles`` are in the IMU frame, ``memory`` has both for compiled code. The arguments
    are standard deviations: of a joint position [rad], and of the model error of a sole position [m] and orientation
    [rad]. Raises ``RobotModelError`` if a joint is not revolute, or moves both a sole and the IMU.
    """

    def __init__(self, model: RobotModel, *, encoder: float, position: float, orientation: float) -> None:
        frames = [*(foot.frame_id for foot in model.feet), model.frame_id("imu")]
        paths = [
            [int(model.pin.idx_vs[j]) - 6 for j in model.pin.supports[model.pin.frames[frame].parentJoint] if j > 1]
            for frame in frames
        ]
        for foot, path in zip(model.feet, paths, strict=False):
            shared = sorted(set(path) & set(paths[2]))
            if shared:
                raise RobotModelError(
                    f"joint '{model.joint_names[shared[0]]}' moves both the {foot.name} sole and the IMU"
                )
        columns = np.full((2, max(map(len, paths[:2]))), -1, dtype=np.int64)
        for row, path in zip(columns, paths, strict=False):
            row[: len(path)] = path
        self.imu = ImuPose(np.eye(3), np.zeros(3), np.zeros((6, len(paths[2]))), np.array(paths[2], dtype=np.int64))
        self.soles = SolePoses(np.zeros((2, 3, 3)), np.zeros((2, 3)), np.zeros((2, 6, 6)))
        variances = PoseVariances(encoder**2, position**2, orientation**2)
        tree, ends = read_tree(model.pin), read_frames(model.pin, frames)
        self.memory = SoleChains(tree, ends, columns, variances, self.imu, self.soles)
        self.update(np.zeros(model.nj))

    def update(self, joints: Vector) -> None:
        """Update all poses at joint positions (nj,) [rad]."""
        sole_poses(joints, self.memory)


@njit(cache=True)
def _joint_column(
    tree: KinematicTree, n: int, rotations: Array, origins: Array, rotation: Array, position: Array, out: Array
) -> None:
    """Column of joint n in the local Jacobian of a frame, linear then angular (6,)."""
    axis, lever, linear = np.empty(3), np.empty(3), np.empty(3)
    rotate(rotations[n + 1], tree[n + 1].axis, axis)
    for i in range(3):
        lever[i] = position[i] - origins[n + 1, i]
    linear[0] = axis[1] * lever[2] - axis[2] * lever[1]
    linear[1] = axis[2] * lever[0] - axis[0] * lever[2]
    linear[2] = axis[0] * lever[1] - axis[1] * lever[0]
    rotate_transposed(rotation, linear, out[0:3])
    rotate_transposed(rotation, axis, out[3:6])


@njit(cache=True)
def sole_poses(joints: Array, chains: SoleChains) -> None:
    """Sole poses in the IMU frame, and their covariance from encoder noise.

    With ``T = T_BI^-1 T_BS`` and local Jacobians, ``dT = J_S dq_S - Ad(T^-1) J_I dq_I``, both in the sole frame. The
    covariance is ``N = s^2 (J_S J_S' + Ad J_I J_I' Ad') + diag(floors)``.
    """
    tree, frames, columns, variances, imu, soles = chains
    rotations, origins = np.empty((tree.shape[0], 3, 3)), np.zeros((tree.shape[0], 3))
    rotations[0] = np.eye(3)
    place_bodies(tree, joints, rotations, origins)
    place_frame(frames, 2, rotations, origins, imu.rotation, imu.position)
    column, offset, lever, spin = np.empty(6), np.empty(3), np.empty(3), np.empty(3)
    turn, position = np.empty((3, 3)), np.empty(3)
    for k in range(imu.columns.shape[0]):
        _joint_column(tree, imu.columns[k], rotations, origins, imu.rotation, imu.position, column)
        imu.jacobian[:, k] = column
    for foot in range(2):
        rotation, seen, covariance = soles.rotations[foot], soles.positions[foot], soles.covariances[foot]
        place_frame(frames, foot, rotations, origins, turn, position)
        for i in range(3):
            offset[i] = position[i] - imu.position[i]
        rotate_transposed(imu.rotation, offset, seen)
        for i in range(3):
            for j in range(3):
                rotation[i, j] = (
                    imu.rotation[0, i] * turn[0, j] + imu.rotation[1, i] * turn[1, j] + imu.rotation[2, i] * turn[2, j]
                )
        covariance[:] = 0.0
        for k in range(columns.shape[1]):
            if columns[foot, k] < 0:
                break
            _joint_column(tree, columns[foot, k], rotations, origins, turn, position, column)
            for i in range(6):
                for j in range(i, 6):
                    covariance[i, j] += variances.encoder * column[i] * column[j]
        for k in range(imu.columns.shape[0]):
            # Twist of the IMU at the sole, linear part v + w x p, then expressed in the sole frame.
            for i in range(3):
                spin[i] = imu.jacobian[3 + i, k]
            lever[0] = imu.jacobian[0, k] + spin[1] * seen[2] - spin[2] * seen[1]
            lever[1] = imu.jacobian[1, k] + spin[2] * seen[0] - spin[0] * seen[2]
            lever[2] = imu.jacobian[2, k] + spin[0] * seen[1] - spin[1] * seen[0]
            rotate_transposed(rotation, lever, column[0:3])
            rotate_transposed(rotation, spin, column[3:6])
            for i in range(6):
                for j in range(i, 6):
                    covariance[i, j] += variances.encoder * column[i] * column[j]
        for i in range(3):
            covariance[i, i] += variances.position
            covariance[i + 3, i + 3] += variances.orientation
        for i in range(6):
            for j in range(i):
                covariance[i, j] = covariance[j, i]


@njit(cache=True)
def base_state(
    rotation: Array, vectors: Array, biases: Array, rate: Array, joints: Array, imu: ImuPose, q: Array, v: Array
) -> None:
    """Write configuration q and velocity v in Pinocchio's order, from the filter's state of the IMU.

    ``rotation`` is R_WI (3, 3). The first rows of ``vectors`` (4, 3) are velocity and position of the IMU in W; the
    first row of ``biases`` (2, 3) is the gyro bias. ``rate`` is the measured angular rate (3,) [rad/s]; ``joints`` are
    positions, velocities, torques (3, nj). ``imu`` is the pose at these positions.
    """
    imu_rotation, imu_position = imu.rotation, imu.position
    base = np.empty((3, 3))
    turned = np.empty(3)
    twist = np.empty((2, 3))  # of the IMU in the IMU frame, without joint motion: linear, angular
    for i in range(3):
        for j in range(3):
            base[i, j] = (
                rotation[i, 0] * imu_rotation[j, 0]
                + rotation[i, 1] * imu_rotation[j, 1]
                + rotation[i, 2] * imu_rotation[j, 2]
            )
    rotate(base, imu_position, turned)
    for i in range(3):
        q[i] = vectors[1, i] - turned[i]
    to_quaternion(base, q[3:7])
    rotate_transposed(rotation, vectors[0], twist[0])
    for i in range(3):
        twist[1, i] = rate[i] - biases[0, i]
    for k in range(imu.columns.shape[0]):
        speed = joints[1, imu.columns[k]]
        for i in range(3):
            twist[0, i] -= imu.jacobian[i, k] * speed
            twist[1, i] -= imu.jacobian[i + 3, k] * speed
    rotate(imu_rotation, twist[0], v[0:3])
    rotate(imu_rotation, twist[1], v[3:6])
    v[0] -= v[4] * imu_position[2] - v[5] * imu_position[1]
    v[1] -= v[5] * imu_position[0] - v[3] * imu_position[2]
    v[2] -= v[3] * imu_position[1] - v[4] * imu_position[0]
    for i in range(joints.shape[1]):
        q[7 + i] = joints[0, i]
        v[6 + i] = joints[1, i]


@njit(cache=True)
def _skew(x: Array, out: Array) -> None:
    """``out <- [x]x`` (3, 3)."""
    out[0, 0], out[0, 1], out[0, 2] = 0.0, -x[2], x[1]
    out[1, 0], out[1, 1], out[1, 2] = x[2], 0.0, -x[0]
    out[2, 0], out[2, 1], out[2, 2] = -x[1], x[0], 0.0


@njit(cache=True)
def _add_product(jacobian: Array, covariance: Array, out: Array) -> None:
    """``out += J P J'``, exactly symmetric."""
    half = jacobian @ covariance
    for i in range(out.shape[0]):
        for j in range(i, out.shape[1]):
            total = 0.0
            for k in range(half.shape[1]):
                total += half[i, k] * jacobian[j, k]
            out[i, j] += total
            if j != i:
                out[j, i] += total


@njit(cache=True)
def base_covariance(
    rotation: Array, position: Array, covariance: Array, imu: ImuPose, variances: Array, out: Array
) -> None:
    """Joint covariance of the base pose in W and the base twist in B.

    xi is the right-invariant error, n_g the error of the present gyro sample, dq and dv are the errors of position and
    velocity of the joints between base and IMU, and J is the local Jacobian of the IMU. To first order::

        dtheta_W = xi_R - R_WI J_w dq
        dp_B     = xi_p - [p_B]x xi_R - R_WI (J_v dq + J_w dq x r_IB)
        dw_B     = R_BI (n_g - xi_bg - J_w dv)
        dv_B     = R_BI (R_WI' xi_v - J_v dv) + [r_BI]x dw_B

    dtheta is a rotation about the fixed axes of W (``R_hat = Exp(dtheta) R``). The linear part of the twist depends on
    neither attitude nor position, so the unobservable directions do not enter it.

    ``rotation`` is R_WI, ``position`` the origin of the IMU in W [m], ``covariance`` that of the filter error (27, 27),
    ``variances`` are of a joint position, a joint velocity and a gyro sample (3,). ``out`` is of x, y, z, the rotation
    about X, Y, Z of W, and the twist in B, linear then angular (12, 12) [m, rad, m/s, rad/s].

    Assumptions:
        The errors of joints and gyro sample are independent of xi. The effect of joint position errors on the twist is
        negligible (0.3 mrad at 1 m/s: 0.3 mm/s).
    """
    imu_rotation, imu_position, imu_jacobian = imu.rotation, imu.position, imu.jacobian
    base = rotation @ imu_rotation.T  # R_WB
    skew = np.empty((3, 3))
    columns = np.empty(12, dtype=np.int64)  # of xi_R, xi_v, xi_p, xi_bg
    jacobian = np.zeros((12, 12))
    for i in range(3):
        columns[i], columns[3 + i] = ROTATION + i, VELOCITY + i
        columns[6 + i], columns[9 + i] = POSITION + i, GYRO_BIAS + i
        jacobian[i, 6 + i] = 1.0
        jacobian[3 + i, i] = 1.0
    _skew(position - base @ imu_position, skew)  # of the base in W
    jacobian[:3, :3] = -skew
    _skew(imu_position, skew)
    turned = skew @ imu_rotation
    jacobian[6:9, 3:6] = imu_rotation @ rotation.T
    jacobian[6:9, 9:] = -turned
    jacobian[9:, 9:] = -imu_rotation
    block = np.empty((12, 12))
    for i in range(12):
        for j in range(12):
            block[i, j] = covariance[columns[i], columns[j]]
    for i in range(9, 12):
        block[i, i] += variances[2]  # n_g enters only the twist, like -xi_bg
    out[:] = 0.0
    _add_product(jacobian, block, out)

    count = imu_jacobian.shape[1]
    if count > 0:
        moved = np.zeros((12, 2 * count))  # columns: joint positions, then joint velocities
        linear, angular = imu_jacobian[:3].copy(), imu_jacobian[3:].copy()
        moved[6:9, count:] = imu_rotation @ linear + turned @ angular
        moved[9:, count:] = imu_rotation @ angular
        _skew(-(imu_rotation.T @ imu_position), skew)  # r_IB
        moved[:3, :count] = rotation @ (linear - skew @ angular)
        moved[3:6, :count] = rotation @ angular
        noise = np.zeros((2 * count, 2 * count))
        for i in range(count):
            noise[i, i], noise[count + i, count + i] = variances[0], variances[1]
        _add_product(moved, noise, out)
