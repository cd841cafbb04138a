"""Calibration of the inertial unit at rest: gyro bias, and what of the accelerometer one attitude shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from controllers.calibration.config import CalibrationConfig
from controllers.calibration.outcome import Outcome, accept, named, refuse
from controllers.calibration.rest import duration, unrest
from controllers.calibration.windows import Window
from models.calibration import Calibration
from models.robot_model import RobotModel
from models.types import Vector


def calibrate_imu(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig
) -> Outcome:
    r"""Gyro bias and the part of the accelerometer's bias along gravity.

    .. math::
        b_w = \bar w - \bar w_k, \qquad u = \bar f / |\bar f|, \qquad b_f = (|\bar f| - g)\, u

    with the means of angular rate and specific force at rest. w_k is how fast the unit turned against the left sole,
    from the encoders, while both feet carried the robot (else 0): a robot with a biased gyro leans slowly while it
    stands. The two components of the accelerometer's bias across gravity look like a tilt of the unit and are not
    observable at one attitude, and neither is a scale error apart from a bias: they stay as they are (0), for the state
    estimator to deal with.

    Args:
        windows: Raw samples, averaged.
        model: The robot.
        base: What the other sensors' part of the result is taken from.
        config: Bounds.

    Returns:
        The calibration, or the reason of the refusal. Details: ``time`` [s], ``samples``, those of ``unrest``,
        ``turning_{x,y,z}`` (w_k) and ``gyro_bias_{x,y,z}`` [rad/s], ``gravity_{x,y,z}`` (u, in the frame of the unit),
        ``accel_norm`` [m/s^2], ``tilt`` of the unit [rad].

    Assumptions:
        The robot stands on something that does not turn: a slow, steady turn cannot be told from a bias.
    """
    limits = config.imu
    time = duration(windows, config.window)
    samples = sum(w.samples for w in windows)
    details: dict[str, float] = {"time": time, "samples": float(samples)}
    if time < limits.min_time or samples < limits.min_samples:
        return refuse(
            f"too few samples: {samples} in {time:.2f} s (at least {limits.min_samples} in {limits.min_time:g} s)",
            details,
        )
    moved, numbers = unrest(windows, model, config.rest)
    details |= numbers
    if moved:
        return refuse(f"the robot moves: {moved}", details)
    rates, forces = np.array([w.gyro for w in windows]), np.array([w.accel for w in windows])
    half = len(windows) // 2
    details["gyro_drift"] = drift = float(np.abs(rates[:half].mean(axis=0) - rates[half:].mean(axis=0)).max())
    if drift > limits.drift:
        return refuse(f"the robot turns: the mean rate drifts by {drift:.3g} rad/s (at most {limits.drift:g})", details)
    turning = _turning(windows, model, config)
    bias, force = rates.mean(axis=0) - turning, forces.mean(axis=0)
    norm = float(np.linalg.norm(force))
    up = force / norm if norm > 0.0 else np.array([0.0, 0.0, 1.0])
    details |= named("turning", turning) | named("gyro_bias", bias) | named("gravity", up)
    details |= {"accel_norm": norm, "tilt": float(np.arccos(np.clip(up[2], -1.0, 1.0)))}
    if abs(norm - config.gravity) > limits.norm_error * config.gravity:
        return refuse(f"the specific force of {norm:.3f} m/s^2 is not gravity ({config.gravity:g} m/s^2)", details)
    found = replace(base, gyro_bias=bias, accel_bias=(norm - config.gravity) * up)
    size = float(np.linalg.norm(bias))
    return accept(f"gyro bias of {size:.4f} rad/s, gravity {norm:.3f} m/s^2, over {time:.1f} s", details, found)


def _turning(windows: Sequence[Window], model: RobotModel, config: CalibrationConfig) -> Vector:
    """Mean angular rate of the unit against the left sole, in the frame of the unit (3,) [rad/s]; 0 off the feet."""
    weight = model.mass * config.gravity
    time = windows[-1].t - windows[0].t
    if min(w.loads.min() for w in windows) < config.feet.air_load * weight or time <= 0.0:
        return np.zeros(3)
    data, q, rotations = model.data(), pin.neutral(model.pin), []
    for window in (windows[0], windows[-1]):
        q[7:] = window.q
        pin.framesForwardKinematics(model.pin, data, q)
        sole, imu = (data.oMf[frame].rotation for frame in (model.feet[0].frame_id, model.frame_id("imu")))
        rotations.append(sole.T @ imu)
    return np.asarray(pin.log3(rotations[0].T @ rotations[1])) / time
