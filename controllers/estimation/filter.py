"""Right-invariant extended Kalman filter of the IMU, both soles and the inertial biases.

State: ``X = (R, v, p, d_L, d_R)`` in SE_4(3), sole rotations ``Z_L, Z_R`` in SO(3), biases ``b_g, b_a``::

    R' = R [w - b_g]x,   v' = R (f - b_a) + g,   p' = v,   d' = noise,   Z' = noise

The measurements are ``y_i = R' (d_i - p)`` and ``C_i = R' Z_i``. With the right-invariant error ``X_hat = Exp(xi) X``
both are linear with constant matrices, and the unobservable directions (yaw, position) are constant. No information can
leak into them, however the estimate moves.

References:
    R. Hartley, M. Ghaffari, R. Eustice, J. Grizzle, "Contact-aided invariant extended Kalman filtering for robot
    state estimation", IJRR 39(4), 2020: its filter with bias augmentation.
    M. Bloesch et al., "State estimation for legged robots", RSS 2012; "... on unstable and slippery terrain",
    IROS 2013 (flat feet as in N. Rotella et al., IROS 2014).
"""

import math
from typing import NamedTuple

import numpy as np

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.filter_kernels import (
    _FOOT_MINUS,
    _FOOT_PLUS,
    ACCEL_BIAS,
    GYRO_BIAS,
    POSITION,
    ROTATION,
    SIZE,
    SOLE,
    VELOCITY,
    Array,
    FilterState,
    Index,
    ProcessNoise,
    SolePoses,
    correct,
    predict,
    retract,
)
from models.numerics.compiled import njit
from models.types import Matrix, Vector

_LEVEL_PLUS = np.array([SOLE, SOLE + 1, SOLE + 3, SOLE + 4])
_LEVEL_MINUS = np.full(4, -1)
#: Standard deviations beyond which the floor counts as sloped and is no measurement of level [-]
_LEVEL_GATE = 3.0
#: Sine of the angle between up and the base's x axis below which that axis has no heading: the robot lies [-]
_LYING = 1e-6
#: Factor on ``foot.slip`` below which a random walk is that of a fully loaded foot, rounding included [-]
FULLY_TRUSTED = 1.01
_REST_PLUS = np.array([VELOCITY, VELOCITY + 1, VELOCITY + 2])
_REST_MINUS = np.full(3, -1)


class NoiseLimits(NamedTuple):
    """``FootNoise`` for kernels; exponents are logarithmic shares of the range from ``swing`` to ``slip`` [-]."""

    swing: float
    slip: float
    pivot: float
    settle_time: float
    settling: float  # exponent of the height of a sole that has just landed
    sink: float  # exponent of the height of a settled sole
    creep: float  # exponent of the horizontal position of a sole that has just landed
    middle: float  # geometric mean of the random walks of a swing and a stance foot [m/sqrt(s)]
    middle_rotation: float  # the same of a tipping and a flat sole [rad/sqrt(s)]
    turn: float
    turn_time: float


class Filter(NamedTuple):
    """State, constants and memory of ``InvariantFilter``."""

    state: FilterState
    limits: NoiseLimits
    densities: Array  # squared, of rate, specific force and the random walks of their biases (4,)
    persistence: float  # of the error of the measured sole poses [s]
    gravity: float  # [m/s^2]
    gate: float  # [-]
    noise: ProcessNoise
    error: Array  # (27,)


class InvariantFilter:
    """Filter with its ``state``, updated in place, and ``memory`` for kernels; the mean of ``innovation`` is 6."""

    def __init__(self, config: EstimatorConfig) -> None:
        self._config = config
        self.state = FilterState.zero()
        self._error = np.zeros(SIZE)
        # Both soles stand on the same floor, so its slope is common to them.
        common = np.tile(np.eye(2, dtype=np.float64), (2, 2)) * config.initial.floor**2  # (4, 4)
        self._level_noise: Matrix = common + np.eye(4) * config.initial.sole**2
        imu = config.imu
        self._densities = np.array([imu.gyro_noise, imu.accel_noise, imu.gyro_bias_walk, imu.accel_bias_walk]) ** 2
        self._noise = ProcessNoise(np.zeros((2, 2)), np.zeros((2, 4)), np.zeros(4), np.zeros((2, 6, 6)))
        foot = config.foot
        # Height noise between swing and sink, at the share of the horizontal noise between swing and slip.
        span = math.log(foot.swing / foot.slip)
        limits = NoiseLimits(
            swing=foot.swing,
            slip=foot.slip,
            pivot=foot.pivot,
            settle_time=foot.settle_time,
            settling=math.log(foot.swing / foot.settling) / span,
            sink=math.log(foot.swing / foot.sink) / span,
            creep=math.log(foot.swing / foot.creep) / span,
            middle=math.sqrt(foot.swing * foot.slip),
            middle_rotation=math.sqrt(foot.tipping * foot.flat),
            turn=foot.turn,
            turn_time=foot.turn_time,
        )
        constants = limits, self._densities, config.kinematics.persistence, config.gravity, config.gate
        self.memory = Filter(self.state, *constants, self._noise, self._error)

    def initialise(self, soles: SolePoses, imu_rotation: Matrix, force: Vector) -> None:
        """Initialise with the robot on the floor: midpoint of the soles at x = y = z = 0, yaw of the base 0.

        Roll and pitch align the nonzero specific force (3,) [m/s^2] with the vertical. An accelerometer bias tilts this
        estimate by ``b / g``. The initial covariance has this correlation, so the filter does not mistake the bias for
        an acceleration. ``soles`` is of the same sample, ``imu_rotation`` is R_BI (3, 3).
        """
        state = self.state
        up = imu_rotation @ (force / np.linalg.norm(force))
        # Base orientation without yaw: its x axis stays in the x-z plane of W.
        x_axis = np.array([1.0, 0.0, 0.0]) - up[0] * up
        if np.linalg.norm(x_axis) < _LYING:
            x_axis = np.array([0.0, 0.0, 1.0]) - up[2] * up
        x_axis /= np.linalg.norm(x_axis)
        base_rotation = np.stack([x_axis, np.cross(up, x_axis), up])
        state.rotation[:] = base_rotation @ imu_rotation
        offsets = soles.positions @ state.rotation.T  # (2, 3)
        state.vectors[0] = 0.0
        state.vectors[1] = -offsets.mean(axis=0)
        state.vectors[2:] = state.vectors[1] + offsets
        for foot in range(2):
            state.soles[foot] = state.rotation @ soles.rotations[foot]
        state.biases[:] = 0.0
        state.innovation[:] = 0.0
        # ``initial.height`` covers the first compression of the soles: only a foot that was loaded settles again.
        state.standing[:], state.bore[:], state.bearing[:] = math.inf, 0.0, 0.0
        self._initialise_covariance(soles)

    def _initialise_covariance(self, soles: SolePoses) -> None:
        config = self._config
        gravity = config.gravity
        state, covariance = self.state, self.state.covariance
        covariance[:] = 0.0
        tilt = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) / gravity  # xi_R = tilt (R b_error)
        sample = config.initial.force**2
        bias = config.imu.accel_bias**2
        block = slice(ROTATION, ROTATION + 3), slice(ACCEL_BIAS, ACCEL_BIAS + 3)
        covariance[block[0], block[0]] = (bias + sample) * tilt @ tilt.T
        covariance[block[0], block[1]] = bias * tilt @ state.rotation
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
            turn = np.kron(np.eye(2), state.soles[foot])
            noise = turn @ soles.covariances[foot] @ turn.T
            rows = _FOOT_MINUS[foot]
            covariance[rows] = covariance[_FOOT_PLUS]
            covariance[:, rows] = covariance[:, _FOOT_PLUS]
            covariance[np.ix_(rows, rows)] = covariance[np.ix_(_FOOT_PLUS, _FOOT_PLUS)] + noise
        covariance[:] = 0.5 * (covariance + covariance.T)

    def measure_rest(self, variance: float) -> int:
        """Correct with zero velocity of a ``variance`` [m^2/s^2]; returns 1 if unusable, else 0."""
        return self._correct(_REST_PLUS, _REST_MINUS, self.state.vectors[0].copy(), np.eye(3) * variance)

    def measure_level(self) -> int:
        """Correct with the assumption that both soles stand on a roughly level floor; returns 1 if unusable, else 0.

        At rest an accelerometer cannot distinguish its bias from a tilt of the base. The floor can, within the accuracy
        of its level. A floor that disagrees by more than three standard deviations is ignored.
        """
        soles = self.state.soles
        # Exp(xi_Z) e_z = Z e_z to first order: xi_Z = e_z x (Z e_z), without its z.
        residual = np.array([-soles[0, 1, 2], soles[0, 0, 2], -soles[1, 1, 2], soles[1, 0, 2]])
        spread = np.diag(self.state.covariance)[_LEVEL_PLUS] + np.diag(self._level_noise)
        if np.any(residual**2 > _LEVEL_GATE**2 * spread):
            return 0
        return self._correct(_LEVEL_PLUS, _LEVEL_MINUS, residual, self._level_noise)

    def _correct(self, plus: Index, minus: Index, residual: Vector, noise: Matrix) -> int:
        if correct(self.state.covariance, plus, minus, residual, noise, self._config.gate, self._error) < 0.0:
            return 1
        retract(self.state, self._error)
        return 0


@njit(cache=True)
def propagate(
    rate: Array, force: Array, dt: float, foot_densities: Array, pivots: Array, scale: float, sole_noise: Array,
    memory: Filter,
) -> None:  # fmt: skip
    """Propagate by ``dt`` [s] with the measured rate [rad/s] and specific force [m/s^2] (3,) in the IMU's frame.

    ``foot_densities`` (2, 2) are random walks of position and orientation of each foot [m/sqrt(s), rad/sqrt(s)],
    ``pivots`` (2, 2) the points about which the soles turn [m]. ``scale`` multiplies the inertial noise. ``sole_noise``
    (2, 6, 6) is the covariance of the sole poses from the encoders.
    """
    state, limits, noise = memory.state, memory.limits, memory.noise
    noise.pivots[:] = pivots
    noise.wander[:] = sole_noise * (2.0 * dt / memory.persistence)
    noise.imu[:] = memory.densities * (scale * scale * dt)
    for foot in range(2):
        position, orientation = foot_densities[foot]
        lies = orientation < limits.middle_rotation
        if lies and position < FULLY_TRUSTED * limits.slip:
            state.bore[foot] = 1.0
        if lies and position < limits.middle:
            state.standing[foot] += dt
        elif state.bore[foot] > 0.0:
            state.standing[foot] = 0.0
        state.bearing[foot] = state.bearing[foot] + dt if position < limits.middle else 0.0
        turn = min(limits.turn, orientation) if state.bearing[foot] > limits.turn_time else orientation
        settled, share = state.standing[foot] > limits.settle_time, position / limits.swing
        height = limits.swing * share ** (limits.sink if settled else limits.settling)
        if not settled:
            position = limits.swing * share**limits.creep
        lift = limits.pivot * orientation  # height noise from the error of the pivot
        variances = noise.feet[foot]
        variances[0], variances[1] = dt * (position * position), dt * (height * height + lift * lift)
        variances[2], variances[3] = dt * (orientation * orientation), dt * (turn * turn)
    predict(state, rate, force, dt, memory.gravity, noise)
