"""Calibration of the leg encoders from the closed chain through both soles and from gravity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from controllers.calibration.config import CalibrationConfig, ChainConfig
from controllers.calibration.windows import Outcome, Window, accept, refuse
from models.calibration import Calibration
from models.robot_model import RobotModel
from models.types import Matrix, Vector

#: Unknowns of the placement of the right sole in the left sole frame: x, y [m], yaw [rad]; both on one level floor
PLACEMENT = 3
#: Unknowns of the IMU: rotation vector of its mounting (3) [rad], accelerometer bias (3) [m/s^2]
MOUNTING = 6


class ChainTerms:
    """Closure error and specific force at x = (joint offsets (k), sole placement (3), IMU mounting and bias (6))."""

    def __init__(self, model: RobotModel) -> None:
        self._model, self._data = model, model.data()
        self._feet = [foot.frame_id for foot in model.feet]
        self._imu = model.frame_id("imu")
        used: set[int] = set()
        for frame in (*self._feet, self._imu):
            chain = model.pin.supports[model.pin.frames[frame].parentJoint]
            used |= {int(model.pin.joints[j].idx_v) - 6 for j in chain if j > 1}
        self.joints = np.array(sorted(used))  #: Indices of the joints of these chains, ascending (k,)
        self.size = self.joints.size + PLACEMENT + MOUNTING  #: Number of unknowns
        self._q = pin.neutral(model.pin)

    def update(self, q: Vector, x: Vector) -> None:
        """Set the measured joint positions q (nj,) [rad] and the unknowns x (n,)."""
        self._q[7:] = q
        self._q[7 + self.joints] -= x[: self.joints.size]
        pin.computeJointJacobians(self._model.pin, self._data, self._q)
        pin.updateFramePlacements(self._model.pin, self._data)

    def _frame(self, frame: int) -> tuple[pin.SE3, Matrix]:
        """Pose in the base frame, and its local Jacobian in the offsets: minus the joint Jacobian (6, k)."""
        jacobian = pin.getFrameJacobian(self._model.pin, self._data, frame, pin.LOCAL)
        return self._data.oMf[frame], -jacobian[:, 6 + self.joints]

    def placement(self) -> pin.SE3:
        """Pose of the right sole in the left sole frame."""
        left, right = (self._data.oMf[frame] for frame in self._feet)
        return left.actInv(right)

    def closure(self, x: Vector) -> tuple[Vector, Matrix]:
        """Closure error of the placement, e = log(T(x)^-1 L^-1 R) (6,), and its Jacobian de/dx (6, n) [m, rad]."""
        k = self.joints.size
        (left, left_jacobian), (right, right_jacobian) = (self._frame(frame) for frame in self._feet)
        relative = left.actInv(right)
        placed = pin.SE3(pin.utils.rotate("z", x[k + 2]), np.array([x[k], x[k + 1], 0.0]))
        error = placed.actInv(relative)
        jacobian = np.zeros((6, self.size))
        jacobian[:, :k] = right_jacobian - relative.toActionMatrixInverse() @ left_jacobian
        moved = np.zeros((6, PLACEMENT))
        moved[:2, :2] = placed.rotation[:2, :2].T
        moved[5, 2] = 1.0
        jacobian[:, k : k + PLACEMENT] = -error.toActionMatrixInverse() @ moved
        return pin.log6(error).vector, pin.Jlog6(error) @ jacobian

    def imu_position(self) -> Vector:
        """Origin of the IMU in the left sole frame (3,) [m]."""
        left, imu = self._data.oMf[self._feet[0]], self._data.oMf[self._imu]
        return np.asarray(left.actInv(imu).translation)

    def force(self, x: Vector, measured: Vector, expected: Vector) -> tuple[Vector, Matrix]:
        """Predicted minus measured specific force in the IMU frame (3,) [m/s^2], and its Jacobian (3, n), at x (n,)."""
        k = self.joints.size
        left, left_jacobian = self._frame(self._feet[0])
        imu, imu_jacobian = self._frame(self._imu)
        relative = left.rotation.T @ imu.rotation
        turn = pin.exp3(x[k + PLACEMENT : k + PLACEMENT + 3])
        up = relative.T @ expected  # in the nominal IMU frame
        force = turn.T @ up
        jacobian = np.zeros((3, self.size))
        spin = imu_jacobian[3:] - relative.T @ left_jacobian[3:]
        jacobian[:, :k] = turn.T @ pin.skew(up) @ spin
        jacobian[:, k + PLACEMENT : k + PLACEMENT + 3] = pin.skew(force) @ pin.Jexp3(x[k + PLACEMENT : -3])
        jacobian[:, -3:] = np.eye(3)
        return force + x[-3:] - measured, jacobian


_CONVERGED = 1e-9  #: Largest Gauss-Newton step of an offset at convergence [rad]
_GAP = 1.5  #: Gap across which accelerations are not computed, in window lengths [-]


def calibrate_closed_chain(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig
) -> Outcome:
    r"""Offsets of the joints between the soles and the IMU, from motions with both soles on the floor.

    .. math::
        \min_x \sum_k \|\log(T_k^{-1} L(q_k - o)^{-1} R(q_k - o))\|^2_{\Sigma_T}
             + \|f_k - E(\mu)^T R_{LI}(q_k - o)^T (g e_z + \ddot p_{LI,k}) - b\|^2_{\Sigma_f}
             + \|T_{k+1} - T_k\|^2_{\Sigma_w} + \|x\|^2_{\Sigma_0},
        \qquad x = (o, \mu, b)

    L, R: sole poses; p_LI: position of the IMU in the left sole frame, differentiated over the windows; T: placement
    (x, y, yaw) of the right sole in the left sole frame, with a random walk for slow creep; mu, b: mounting and bias of
    the IMU; Sigma_0: prior, ``chain.prior`` for the offsets, the data sheet for mu and b. A Kalman filter over the
    windows solves each Gauss-Newton step; its final covariance is the posterior.

    ``windows`` are averages of raw samples from a motion of the base over both soles. ``base`` supplies the calibration
    of the other sensors and joints. Details: the offset of each joint by name [rad], its posterior standard deviation
    as ``sigma_<joint>`` [rad], ``singular_max``, ``singular_min`` of the data without the prior [1/rad], ``residual``
    (RMS of the whitened innovations) [-], ``windows``, ``joints_untouched``.

    Assumptions:
        The floor is flat and level. The soles stand flat and do not slip.
    """
    terms, limits = ChainTerms(model), config.chain
    weight = model.mass * config.gravity
    usable = [w for w in windows if w.loads.min() > config.feet.air_load * weight and w.speed < limits.speed_max]
    details = {"windows": float(len(usable)), "windows_left_out": float(len(windows) - len(usable))}
    if len(usable) < limits.min_windows:
        return refuse(f"{len(usable)} usable windows on both soles, at least {limits.min_windows} required", details)
    k = terms.joints.size
    prior, x = _prior(model, terms, limits), np.zeros(terms.size)
    terms.update(usable[0].q, x)
    x[k : k + 2] = terms.placement().translation[:2]
    for i in range(limits.iterations):
        gate = limits.gate if i >= limits.free_iterations else math.inf
        fit = _filter(usable, terms, x, prior, gate, config)
        x += fit.step
        if i > limits.free_iterations and np.abs(fit.step[:k]).max() < _CONVERGED:
            break
    details["residual"], details["windows_gated"] = residual, gated = fit.residual, float(fit.gated)
    sigma = np.sqrt(np.diag(fit.covariance)[:k])
    details |= _observability(fit.covariance[:k, :k], limits.prior)
    names = [model.joint_names[i] for i in terms.joints]
    details |= {f"sigma_{name}": float(value) for name, value in zip(names, sigma, strict=True)}
    if residual > limits.residual_max or gated > limits.gated_max * len(usable):
        return refuse(
            f"the soles slip, or the floor is not level: residual {residual:.1f} times its noise "
            f"(at most {limits.residual_max:g}), {gated:.0f} of {len(usable)} windows are outliers (at most "
            f"{limits.gated_max:.0%})",
            details,
        )
    poor = [f"{name} ({value:.4f} rad)" for name, value in zip(names, sigma, strict=True) if value > limits.sigma_max]
    if poor:
        return refuse(
            f"the data does not determine {', '.join(poor)}: at most {limits.sigma_max:g} rad required; move the base "
            "further over both soles, turning and tilting it",
            details,
        )
    offsets = base.encoder_offsets.copy()
    offsets[terms.joints] = x[:k]
    untouched = model.nj - k
    details |= {name: float(value) for name, value in zip(names, x[:k], strict=True)}
    details["joints_untouched"] = float(untouched)
    worst = int(sigma.argmax())
    return accept(
        f"offsets of {k} joints, the largest {np.abs(x[:k]).max():.4f} rad, known to {sigma[worst]:.4f} rad "
        f"('{names[worst]}') or better; {untouched} joints that are not between the soles and the IMU are "
        "not observable and remain unchanged",
        details,
        replace(base, encoder_offsets=offsets),
    )


def _prior(model: RobotModel, terms: ChainTerms, limits: ChainConfig) -> Vector:
    """Prior standard deviations of the unknowns (n,)."""
    imu = model.profile.sensors.imu
    return np.concatenate(
        [
            np.full(terms.joints.size, limits.prior),
            np.full(PLACEMENT, limits.placement),
            np.full(3, max(imu.misalignment, limits.misalignment)),
            np.full(3, max(imu.accel_bias, limits.accel_bias)),
        ]
    )


@dataclass(frozen=True, slots=True)
class _Fit:
    step: Vector  # change of the unknowns (n,)
    covariance: Matrix  # of the unknowns (n, n)
    residual: float  # RMS of the whitened innovations [-]
    gated: int  # number of windows with reduced weight because their innovation is an outlier


def _filter(
    windows: Sequence[Window], terms: ChainTerms, x: Vector, sigma: Vector, gate: float,
    config: CalibrationConfig,
) -> _Fit:  # fmt: skip
    """Kalman filter over the windows for the Gauss-Newton step about x; the placement is a random walk."""
    limits, k = config.chain, terms.joints.size
    share = min(config.window / limits.correlation, 1.0)
    closure = np.array([limits.slide, limits.slide, limits.height, limits.tilt, limits.tilt, limits.turn])
    placed = slice(k, k + PLACEMENT)
    step = np.zeros(terms.size)
    step[:k], step[-MOUNTING:] = -x[:k], -x[-MOUNTING:]  # prior mean 0; for the placement, its current value
    covariance = np.diag(sigma**2)
    walk = np.array([limits.slide_walk, limits.slide_walk, limits.turn_walk]) ** 2
    squares, gated, last = 0.0, 0, windows[0].t
    forces = _expected_forces(windows, terms, x, config)
    for window, expected in zip(windows, forces, strict=True):
        diagonal = covariance.diagonal()[placed] + walk * (window.t - last)
        last = window.t
        covariance[range(k, k + PLACEMENT), range(k, k + PLACEMENT)] = diagonal
        terms.update(window.q, x)
        error, jacobian = terms.closure(x)
        noise = closure**2 / share
        if expected is not None:
            force_error, force_jacobian = terms.force(x, window.accel, expected)
            error = np.concatenate([error, force_error])
            jacobian = np.vstack([jacobian, force_jacobian])
            noise = np.concatenate([noise, np.full(3, limits.accel**2)])
        innovation = error + jacobian @ step  # (6,) or (9,)
        spread = jacobian @ covariance @ jacobian.T + np.diag(noise)
        square = float(innovation @ np.linalg.solve(spread, innovation)) / innovation.size
        if square > gate:  # jolt or slip: reduced weight; if ignored, one slip would exclude all later windows
            gated += 1
            spread += np.diag(noise) * (square / gate - 1.0)
            noise = noise * square / gate
        gain = np.linalg.solve(spread, jacobian @ covariance).T  # (n, 6 or 9)
        step = step - gain @ innovation
        left = np.eye(terms.size) - gain @ jacobian
        covariance = left @ covariance @ left.T + (gain * noise) @ gain.T
        squares += min(square, gate)
    return _Fit(step, covariance, float(np.sqrt(squares / len(windows))), gated)


def _expected_forces(
    windows: Sequence[Window], terms: ChainTerms, x: Vector, config: CalibrationConfig
) -> list[Vector | None]:
    """Expected specific force of each window in the left sole frame (3,) [m/s^2]; None next to a gap."""
    places, up = [], np.array([0.0, 0.0, config.gravity])
    for window in windows:
        terms.update(window.q, x)
        places.append(terms.imu_position())
    result: list[Vector | None] = [None] * len(windows)
    for i in range(1, len(windows) - 1):
        before, after = windows[i].t - windows[i - 1].t, windows[i + 1].t - windows[i].t
        if max(before, after) < _GAP * config.window:
            speeds = (places[i] - places[i - 1]) / before, (places[i + 1] - places[i]) / after
            result[i] = up + (speeds[1] - speeds[0]) / (0.5 * (before + after))
    return result


def _observability(covariance: Matrix, prior: float) -> dict[str, float]:
    """Singular values of the information of the data on the offsets [1/rad]: posterior minus prior information."""
    information = 1.0 / np.linalg.eigvalsh(covariance) - 1.0 / prior**2
    singular = np.sqrt(np.maximum(information, 0.0))
    return {"singular_max": float(singular.max()), "singular_min": float(singular.min())}
