"""Whether the robot was at rest, and if not, what moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from controllers.calibration.config import RestConfig
from controllers.calibration.windows import Window
from models.robot_model import RobotModel


def duration(windows: Sequence[Window], length: float) -> float:
    """Time that windows of a length cover [s]."""
    return len(windows) * length


def unrest(windows: Sequence[Window], model: RobotModel, config: RestConfig) -> tuple[str, dict[str, float]]:
    """Judge a stretch of windows.

    Args:
        windows: At least one.
        model: The robot.
        config: Bounds.

    Returns:
        What moved, empty when nothing did, and the numbers: ``joint_speed`` [rad/s], ``joint_drift`` [rad],
        ``gyro_spread`` [rad/s], ``accel_spread`` [m/s^2], the spreads being standard deviations of window means.
    """
    speeds = np.abs([w.v for w in windows]).max(axis=0)  # (nj,)
    drifts = np.ptp([w.q for w in windows], axis=0)  # (nj,)
    details = {
        "joint_speed": float(speeds.max()),
        "joint_drift": float(drifts.max()),
        "gyro_spread": float(np.std([w.gyro for w in windows], axis=0).max()),
        "accel_spread": float(np.std([w.accel for w in windows], axis=0).max()),
    }
    if details["joint_speed"] > config.joint_speed:
        return _joint(model, speeds, "moves at", "rad/s", config.joint_speed), details
    if details["joint_drift"] > config.joint_drift:
        return _joint(model, drifts, "has moved by", "rad", config.joint_drift), details
    if details["gyro_spread"] > config.gyro_spread:
        spread = details["gyro_spread"]
        return f"the angular rate varies by {spread:.3g} rad/s (at most {config.gyro_spread:g})", details
    if details["accel_spread"] > config.accel_spread:
        spread = details["accel_spread"]
        return f"the specific force varies by {spread:.3g} m/s^2 (at most {config.accel_spread:g})", details
    return "", details


def _joint(
    model: RobotModel, values: np.ndarray[tuple[int, ...], np.dtype[np.float64]], verb: str, unit: str, limit: float
) -> str:
    i = int(np.argmax(values))
    return f"joint '{model.joint_names[i]}' {verb} {values[i]:.3g} {unit} (at most {limit:g})"
