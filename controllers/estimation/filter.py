"""Right-invariant extended Kalman filter of the inertial unit, both soles and the inertial biases.

State: ``X = (R, v, p, d_L, d_R)`` in SE_4(3), sole rotations ``Z_L, Z_R`` in SO(3), biases ``b_g, b_a``::

    R' = R [w - b_g]x,   v' = R (f - b_a) + g,   p' = v,   d' = noise,   Z' = noise

measured through ``y_i = R' (d_i - p)`` and ``C_i = R' Z_i``. With the right-invariant error ``X_hat = Exp(xi) X``
both measurements are linear with constant matrices, and the unobservable directions (yaw, position) are constant:
no information can leak into them, however the estimate moves.

References:
    R. Hartley, M. Ghaffari, R. Eustice, J. Grizzle, "Contact-aided invariant extended Kalman filtering for robot
    state estimation", IJRR 39(4), 2020: its filter with bias augmentation.
    M. Bloesch et al., "State estimation for legged robots", RSS 2012; "... on unstable and slippery terrain",
    IROS 2013 (flat feet as in N. Rotella et al., IROS 2014).
"""

from __future__ import annotations

import math

import numpy as np

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.kernels_predict import (
    ACCEL_BIAS,
    FOOT,
    GYRO_BIAS,
    POSITION,
    ROTATION,
    SIZE,
    SOLE,
    VELOCITY,
    predict,
    retract,
)
from controllers.estimation.kernels_update import correct, correct_soles
from controllers.estimation.kinematics import SoleKinematics
from models.types import Matrix, Vector

_FOOT_PLUS = np.array([POSITION, POSITION + 1, POSITION + 2, ROTATION, ROTATION + 1, ROTATION + 2])
_FOOT_MINUS = np.array([FOOT, FOOT + 1, FOOT + 2, SOLE, SOLE + 1, SOLE + 2]) + 3 * np.arange(2)[:, None]
_LEVEL_PLUS = np.array([SOLE, SOLE + 1, SOLE + 3, SOLE + 4])
_LEVEL_MINUS = np.full(4, -1)
_LEVEL_GATE = 3.0
"""Standard deviations beyond which the floor is taken for a real slope, and its level for no information [-]."""
_LYING = 1e-6
"""Sine of the angle between up and the base's x axis below which the robot lies and that axis has no heading [-]."""
FULLY_TRUSTED = 1.01
"""Factor on ``foot.slip`` below which the random walk of a foot is that of one that bears, rounding aside [-]."""
_REST_PLUS = np.array([VELOCITY, VELOCITY + 1, VELOCITY + 2])
_REST_MINUS = np.full(3, -1)


class InvariantFilter:
    """The filter; every array is updated in place.

    Attributes:
        rotation: R, orientation of the inertial unit in W (3, 3).
        vectors: Its velocity v and position p in W, then both sole positions d in W (4, 3) [m/s, m].
        soles: Z, orientation of each sole in W (2, 3, 3).
        biases: Gyro, accelerometer (2, 3) [rad/s, m/s^2].
        covariance: Of the error [R, v, p, d_L, d_R, Z_L, Z_R, b_g, b_a] (27, 27).
        innovation: Normalised innovation squared of the last update of each foot (2,) [-]; 6 on average.

    Args:
        config: Noises and bounds.
    """

    def __init__(self, config: EstimatorConfig) -> None:
        self._config = config
        self.rotation = np.eye(3)
        self.vectors = np.zeros((4, 3))
        self.soles = np.tile(np.eye(3), (2, 1, 1))
        self.biases = np.zeros((2, 3))
        self.covariance = np.eye(SIZE)
        self.innovation = np.zeros(2)
        self._error = np.zeros(SIZE)
        self._rest_noise = np.eye(3) * config.rest.velocity**2
        # Both soles stand on the same floor, so its slope is common to them.
        common = np.tile(np.eye(2, dtype=np.float64), (2, 2)) * config.initial.floor**2  # (4, 4)
        self._level_noise: Matrix = common + np.eye(4) * config.initial.sole**2
        imu = config.imu
        self._densities = np.array([imu.gyro_noise, imu.accel_noise, imu.gyro_bias_walk, imu.accel_bias_walk]) ** 2
        self._imu_variances = np.zeros(4)
        self._foot_variances = np.zeros((2, 3))
        self._wander = np.zeros((2, 6, 6))
        foot = config.foot
        # Height between swing and sink, as far on the way as the horizontal position is between swing and slip.
        span = math.log(foot.swing / foot.slip)
        self._exponents = (math.log(foot.swing / foot.settling) / span, math.log(foot.swing / foot.sink) / span)
        self._creep = math.log(foot.swing / foot.creep) / span
        self._middle = math.sqrt(foot.swing * foot.slip)
        self._middle_rotation = math.sqrt(foot.tipping * foot.flat)
        self._standing = [math.inf, math.inf]
        self._bore = [False, False]

    def initialise(self, kinematics: SoleKinematics, force: Vector) -> None:
        """Stand the robot on the floor: soles' middle at x = y = 0, soles at z = 0, yaw of the base 0.

        Roll and pitch make the specific force vertical. An accelerometer bias tilts this estimate by ``b / g``:
        the covariance starts with that correlation, so the filter does not take the bias for an acceleration.

        Args:
            kinematics: Updated with the same sample.
            force: Specific force in the inertial unit's frame (3,) [m/s^2]; must not be zero.
        """
        up = kinematics.imu_rotation @ (force / np.linalg.norm(force))
        # Base orientation without yaw: its x axis stays in the x-z plane of W.
        x_axis = np.array([1.0, 0.0, 0.0]) - up[0] * up
        if np.linalg.norm(x_axis) < _LYING:
            x_axis = np.array([0.0, 0.0, 1.0]) - up[2] * up
        x_axis /= np.linalg.norm(x_axis)
        base_rotation = np.stack([x_axis, np.cross(up, x_axis), up])
        self.rotation[:] = base_rotation @ kinematics.imu_rotation
        offsets = kinematics.positions @ self.rotation.T  # (2, 3)
        self.vectors[0] = 0.0
        self.vectors[1] = -offsets.mean(axis=0)
        self.vectors[2:] = self.vectors[1] + offsets
        for foot in range(2):
            self.soles[foot] = self.rotation @ kinematics.rotations[foot]
        self.biases[:] = 0.0
        self.innovation[:] = 0.0
        # The give of the soles under the first load is part of ``initial.height``: only what bore can settle again.
        self._standing[:] = math.inf, math.inf
        self._bore[:] = False, False
        self._initialise_covariance(kinematics)

    def _initialise_covariance(self, kinematics: SoleKinematics) -> None:
        config = self._config
        gravity = config.gravity
        covariance = self.covariance
        covariance[:] = 0.0
        tilt = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) / gravity  # xi_R = tilt (R b_error)
        sample = config.initial.force**2
        bias = config.imu.accel_bias**2
        block = slice(ROTATION, ROTATION + 3), slice(ACCEL_BIAS, ACCEL_BIAS + 3)
        covariance[block[0], block[0]] = (bias + sample) * tilt @ tilt.T
        covariance[block[0], block[1]] = bias * tilt @ self.rotation
        covariance[block[1], block[0]] = covariance[block[0], block[1]].T
        diagonal = np.zeros(SIZE)
        diagonal[ROTATION : ROTATION + 3] = config.initial.heading**2
        diagonal[VELOCITY : VELOCITY + 3] = config.initial.velocity**2
        diagonal[POSITION : POSITION + 2] = config.initial.position**2
        diagonal[POSITION + 2] = config.initial.height**2
        diagonal[GYRO_BIAS : GYRO_BIAS + 3] = config.imu.gyro_bias**2
        diagonal[ACCEL_BIAS : ACCEL_BIAS + 3] = bias
        covariance[np.diag_indices(SIZE)] += diagonal
        for foot in range(2):
            # xi_d = xi_p + noise and xi_Z = xi_R + noise, with the noise of the sole's measured pose in W.
            turn = np.kron(np.eye(2), self.soles[foot])
            noise = turn @ kinematics.covariances[foot] @ turn.T
            rows = _FOOT_MINUS[foot]
            covariance[rows] = covariance[_FOOT_PLUS]
            covariance[:, rows] = covariance[:, _FOOT_PLUS]
            covariance[np.ix_(rows, rows)] = covariance[np.ix_(_FOOT_PLUS, _FOOT_PLUS)] + noise
        covariance[:] = 0.5 * (covariance + covariance.T)

    def predict(
        self,
        rate: Vector,
        force: Vector,
        dt: float,
        foot_densities: Matrix,
        pivots: Matrix,
        scale: float,
        sole_noise: Matrix,
    ) -> None:
        """Propagate by one step.

        Args:
            rate: Measured angular velocity in the inertial unit's frame (3,) [rad/s].
            force: Measured specific force (3,) [m/s^2].
            dt: Step [s].
            foot_densities: Random walk of position and orientation of each foot (2, 2) [m/sqrt(s), rad/sqrt(s)].
            pivots: Point of each sole about which it turns, in its frame (2, 2) [m].
            scale: Multiplier of the inertial noise densities [-].
            sole_noise: Covariance of the sole poses that the encoders give, in the sole frames (2, 6, 6).
        """
        np.multiply(sole_noise, 2.0 * dt / self._config.kinematics.persistence, out=self._wander)
        np.multiply(self._densities, scale * scale * dt, out=self._imu_variances)
        config, variances = self._config.foot, self._foot_variances
        for foot in range(2):
            position, orientation = float(foot_densities[foot, 0]), float(foot_densities[foot, 1])
            lies = orientation < self._middle_rotation
            self._bore[foot] |= lies and position < FULLY_TRUSTED * config.slip
            if lies and position < self._middle:
                self._standing[foot] += dt
            elif self._bore[foot]:
                self._standing[foot] = 0.0
            settled, share = self._standing[foot] > config.settle_time, position / config.swing
            height = config.swing * share ** self._exponents[int(settled)]
            if not settled:
                position = config.swing * share**self._creep
            lift = config.pivot * orientation  # of a sole that turns about a point this far from where it is thought
            variances[foot] = position * position, height * height + lift * lift, orientation * orientation
        variances *= dt
        predict(
            self.rotation, self.vectors, self.soles, self.covariance, rate - self.biases[0], force - self.biases[1],
            dt, self._config.gravity, pivots, self._foot_variances, self._imu_variances, self._wander,
        )  # fmt: skip

    def measure_soles(self, kinematics: SoleKinematics) -> int:
        """Correct with the pose of both soles; returns how many were unusable (0 in a sound filter)."""
        rejected: int = correct_soles(
            self.rotation, self.vectors, self.soles, self.biases, self.covariance, kinematics.positions,
            kinematics.rotations, kinematics.covariances, _FOOT_PLUS, _FOOT_MINUS, self._config.gate, self._error,
            self.innovation,
        )  # fmt: skip
        return rejected

    def measure_rest(self) -> int:
        """Correct with the knowledge that the robot does not move; returns 1 when unusable."""
        squared = correct(
            self.covariance, _REST_PLUS, _REST_MINUS, self.vectors[0].copy(), self._rest_noise, self._config.gate,
            self._error,
        )  # fmt: skip
        if squared < 0.0:
            return 1
        retract(self.rotation, self.vectors, self.soles, self.biases, self._error)
        return 0

    def measure_level(self) -> int:
        """Correct with the knowledge that both soles stand flat on a floor that is about level.

        An accelerometer cannot tell its bias from a tilt of the base while the base does not turn; the floor can,
        as well as floors are level. A floor that disagrees by more than three standard deviations is left alone.

        Returns:
            1 when unusable, else 0.
        """
        # Exp(xi_Z) e_z = Z e_z to first order: xi_Z = e_z x (Z e_z), without its z.
        residual = np.array([-self.soles[0, 1, 2], self.soles[0, 0, 2], -self.soles[1, 1, 2], self.soles[1, 0, 2]])
        spread = np.diag(self.covariance)[_LEVEL_PLUS] + np.diag(self._level_noise)
        if np.any(residual**2 > _LEVEL_GATE**2 * spread):
            return 0
        squared = correct(
            self.covariance, _LEVEL_PLUS, _LEVEL_MINUS, residual, self._level_noise, self._config.gate, self._error
        )
        if squared < 0.0:
            return 1
        retract(self.rotation, self.vectors, self.soles, self.biases, self._error)
        return 0
