"""Compiled feedback terms: small vector laws whose NumPy form would cost more than the QP."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from controllers.memory import part_1, part_2, part_3
from controllers.qp.kernels_read import POSE, TWIST, Q, V
from controllers.qp.kernels_terms import rotation_error
from models.compiled import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LIMITS = (
    "torque",
    "acceleration_lower",
    "acceleration_upper",
    "contact_acceleration",
    "wrench_target",
    "wrench_weight",
    "q_low",
    "q_high",
    "v_max",
    "gains",
    "q_min",
    "q_max",
)
"""Parts of the block of ``QPLimits``."""

TORQUE, ACCELERATION_LOWER, ACCELERATION_UPPER, CONTACT_ACCELERATION, WRENCH_TARGET, WRENCH_WEIGHT = range(6)
_Q_LOW, _Q_HIGH, _V_MAX, _GAINS, Q_MIN, Q_MAX = range(6, 12)


@njit(cache=True)
def proportional_derivative(
    feedforward: Array,
    kp: Array,
    wanted: Array,
    measured: Array,
    kd: Array,
    wanted_rate: Array,
    measured_rate: Array,
    out: Array,
) -> None:
    """``out = feedforward + kp (wanted - measured) + kd (wanted_rate - measured_rate)``, all (k,)."""
    for i in range(out.shape[0]):
        out[i] = feedforward[i] + kp[i] * (wanted[i] - measured[i]) + kd[i] * (wanted_rate[i] - measured_rate[i])


@njit(cache=True)
def orientation_feedback(
    rotation: Array, wanted: Array, rate: Array, kp: Array, kd: Array, error: Array, out: Array
) -> None:
    """``out = kp log(R' R_ref) - kd w`` in the moving frame; the error is written too.

    Args:
        rotation: R, the upper left (3, 3) of any larger matrix.
        wanted: R_ref (3, 3).
        rate: Angular velocity in the moving frame (3,).
        kp: Gains (3,).
        kd: Gains (3,).
        error: Out, rotation vector (3,).
        out: Out (3,).
    """
    rotation_error(rotation, wanted, error)
    for i in range(3):
        out[i] = kp[i] * error[i] - kd[i] * rate[i]


@njit(cache=True)
def pose_error(pose: Array, rotation: Array, position: Array, out: Array) -> None:
    """Position and rotation from a frame to a wanted pose, in the frame (6,).

    Args:
        pose: Homogeneous transform of the frame in W (4, 4).
        rotation: Wanted rotation in W (3, 3).
        position: Wanted origin in W (3,).
        out: Out (6,).
    """
    for i in range(3):
        total = 0.0
        for k in range(3):
            total += pose[k, i] * (position[k] - pose[k, 3])
        out[i] = total
    rotation_error(pose, rotation, out[3:])


@njit(cache=True)
def foothold_feedback(pose: Array, twist: Array, rotation: Array, position: Array, gains: Array, out: Array) -> None:
    """Acceleration that draws a planted sole to its foothold: ``stiffness * error - damping * twist`` (6,), bounded.

    ``gains`` starts with stiffness and damping and ends with the largest linear [m/s^2] and angular [rad/s^2] value.
    """
    pose_error(pose, rotation, position, out)
    for i in range(6):
        limit = gains[5] if i < 3 else gains[6]
        out[i] = min(max(gains[0] * out[i] - gains[1] * twist[i], -limit), limit)


@njit(cache=True)
def joint_bounds(
    q: Array,
    v: Array,
    q_low: Array,
    q_high: Array,
    v_max: Array,
    position_gain: float,
    velocity_gain: float,
    largest: float,
    lower: Array,
    upper: Array,
) -> None:
    """Acceleration bounds from position and velocity limits.

    With ``v_hi = clip(g (q_high - q), -v_max, v_max)``: ``a <= clip(k (v_hi - v), -largest, largest)``; below likewise.

    Args:
        q: Joint state (nj,).
        v: Joint state (nj,).
        q_low: Position limits less their margin (nj,).
        q_high: Position limits less their margin (nj,).
        v_max: Usable speed (nj,).
        position_gain: g [1/s].
        velocity_gain: k [1/s].
        largest: Largest bound [rad/s^2].
        lower: Out (nj,).
        upper: Out (nj,).
    """
    for i in range(q.shape[0]):
        fastest = min(max(position_gain * (q_high[i] - q[i]), -v_max[i]), v_max[i])
        slowest = min(max(position_gain * (q_low[i] - q[i]), -v_max[i]), v_max[i])
        upper[i] = min(max(velocity_gain * (fastest - v[i]), -largest), largest)
        lower[i] = min(max(velocity_gain * (slowest - v[i]), -largest), largest)


@njit(cache=True)
def update_limits(
    rotations: Array,
    positions: Array,
    terms: Array,
    terms_layout: Index,
    limits: Array,
    layout: Index,
) -> None:
    """Joint bounds and contact accelerations of this tick, from ``joint_bounds`` and ``foothold_feedback``.

    Args:
        rotations: Rotation of each foothold in W (2, 3, 3).
        positions: Position of each foothold in W (2, 3) [m].
        terms: Block of ``Terms``.
        terms_layout: Its layout.
        limits: In and out, block with the parts ``LIMITS``.
        layout: Its layout.
    """
    pose, twist = part_3(terms, terms_layout, POSE), part_2(terms, terms_layout, TWIST)
    gains, wanted = part_1(limits, layout, _GAINS), part_2(limits, layout, CONTACT_ACCELERATION)
    for foot in range(2):
        foothold_feedback(pose[foot], twist[foot], rotations[foot], positions[foot], gains, wanted[foot])
    joint_bounds(
        part_1(terms, terms_layout, Q)[7:],
        part_1(terms, terms_layout, V)[6:],
        part_1(limits, layout, _Q_LOW),
        part_1(limits, layout, _Q_HIGH),
        part_1(limits, layout, _V_MAX),
        gains[2],
        gains[3],
        gains[4],
        part_1(limits, layout, ACCELERATION_LOWER),
        part_1(limits, layout, ACCELERATION_UPPER),
    )


@njit(cache=True)
def integrate_joints(
    q: Array, v: Array, acceleration: Array, ahead: float, q_low: Array, q_high: Array, q_out: Array, v_out: Array
) -> None:
    """Joint positions, kept inside the limits, and velocities after a look-ahead at constant acceleration (nj,)."""
    for i in range(q.shape[0]):
        step = ahead * acceleration[i]
        q_out[i] = min(max(q[i] + ahead * (v[i] + 0.5 * step), q_low[i]), q_high[i])
        v_out[i] = v[i] + step
