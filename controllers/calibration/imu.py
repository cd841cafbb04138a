"""Calibration of the inertial unit at rest: gyro bias, and what of the accelerometer one attitude shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controllers.calibration.config import CalibrationConfig
from controllers.calibration.outcome import Outcome, accept, named, refuse
from controllers.calibration.rest import duration, unrest
from controllers.calibration.windows import Window
from models.calibration import Calibration
from models.robot_model import RobotModel


def calibrate_imu(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig
) -> Outcome:
    r"""Gyro bias and the part of the accelerometer's bias along gravity.

    .. math::
        b_w = \bar w, \qquad u = \bar f / |\bar f|, \qquad b_f = (|\bar f| - g)\, u

    with the means of angular rate and specific force at rest. The two components of the accelerometer's bias across
    gravity look like a tilt of the unit and are not observable at one attitude, and neither is a scale error apart from
    a bias: they stay as they are (0), for the state estimator to deal with.

    Args:
        windows: Raw samples, averaged.
        model: The robot.
        base: What the other sensors' part of the result is taken from.
        config: Bounds.

    Returns:
        The calibration, or the reason of the refusal. Details: ``time`` [s], ``samples``, those of ``unrest``,
        ``gyro_bias_{x,y,z}`` [rad/s], ``gravity_{x,y,z}`` (u, in the frame of the unit), ``accel_norm`` [m/s^2],
        ``tilt`` of the unit [rad].

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
    bias, force = rates.mean(axis=0), forces.mean(axis=0)
    norm = float(np.linalg.norm(force))
    up = force / norm if norm > 0.0 else np.array([0.0, 0.0, 1.0])
    details |= named("gyro_bias", bias) | named("gravity", up)
    details |= {"accel_norm": norm, "tilt": float(np.arccos(np.clip(up[2], -1.0, 1.0)))}
    if abs(norm - config.gravity) > limits.norm_error * config.gravity:
        return refuse(f"the specific force of {norm:.3f} m/s^2 is not gravity ({config.gravity:g} m/s^2)", details)
    found = replace(base, gyro_bias=bias, accel_bias=(norm - config.gravity) * up)
    size = float(np.linalg.norm(bias))
    return accept(f"gyro bias of {size:.4f} rad/s, gravity {norm:.3f} m/s^2, over {time:.1f} s", details, found)
