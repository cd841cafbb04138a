"""Calibration of the foot sensors: offsets in the air, gains from the known weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from controllers.calibration.config import CalibrationConfig
from controllers.calibration.outcome import Outcome, accept, refuse
from controllers.calibration.rest import duration, unrest
from controllers.calibration.windows import Window
from models.calibration import Calibration
from models.robot_model import RobotModel
from models.types import FOOT_NAMES


def calibrate_feet(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig
) -> Outcome:
    r"""Offsets from windows in the air, gains from windows at rest on both feet; either or both.

    .. math::
        o_i = \bar W_i \;\text{(air)}, \qquad
        \min_{g} \sum_k \Big(\frac{\sum_i g_i (f_{ik} - o_i) - m g}{\sigma_m}\Big)^2
                + \sum_i \Big(\frac{g_i - 1}{\sigma_g}\Big)^2 \;\text{(standing)}

    f_ik: measured normal force of foot i in window k [N]; m: mass of the robot as the model has it. Both gains are
    told apart only when the load has moved from one foot to the other by ``min_shift``; otherwise both get the same.
    New offsets set the gains back to 1: those were found with the old ones.

    Args:
        windows: Raw samples, averaged.
        model: The robot.
        base: Present calibration: its offsets are used when there is no window in the air.
        config: Bounds.

    Returns:
        The calibration, or the reason of the refusal. Details: ``time_air``, ``time_standing`` [s], offsets
        ``left_fx`` ... ``right_tz`` [N, N.m], ``left_gain``, ``right_gain`` [-], ``shift`` [-].

    Assumptions:
        Nothing but the robot hangs on it or lies on it; the floor is level; below the sensor there is no mass.
    """
    weight = model.mass * config.gravity
    loads = [float(np.abs(w.loads).sum()) for w in windows]
    air = [w for w, load in zip(windows, loads, strict=True) if load < config.feet.air_load * weight]
    standing = [w for w, load in zip(windows, loads, strict=True) if load > config.feet.stand_load * weight]
    details = {
        "time_air": duration(air, config.window),
        "time_standing": duration(standing, config.window),
        "weight": weight,
    }
    enough_air = details["time_air"] >= config.feet.min_time
    if not enough_air and details["time_standing"] < config.feet.min_time:
        return refuse(_neither(loads, weight, config), details)
    found, parts = base, []
    if enough_air:
        result = _offsets(air, model, found, config, details)
        if result.calibration is None:
            return result
        found, details = result.calibration, result.reply.details
        parts.append(result.reply.reason)
    if details["time_standing"] >= config.feet.min_time:
        result = _gains(standing, model, found, config, details)
        if result.calibration is None:
            return result
        found, details = result.calibration, result.reply.details
        parts.append(result.reply.reason)
    return accept("; ".join(parts), details, found)


def _neither(loads: Sequence[float], weight: float, config: CalibrationConfig) -> str:
    if not loads:
        return "too few samples: no window was filled"
    return (
        f"the feet carry {np.mean(loads):.0f} N: neither in the air (below {config.feet.air_load * weight:.0f} N) nor "
        f"standing (above {config.feet.stand_load * weight:.0f} N) for {config.feet.min_time:g} s"
    )


def _offsets(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig,
    details: dict[str, float],
) -> Outcome:  # fmt: skip
    moved, numbers = unrest(windows, model, config.rest)
    details = details | numbers
    if moved:
        return refuse(f"the robot moves in the air: {moved}", details)
    wrenches = np.array([w.wrenches for w in windows])  # (k, 2, 6)
    spread = float(wrenches[:, :, :3].std(axis=0).max())
    details["force_spread"] = spread
    limit = config.feet.air_spread * model.mass * config.gravity
    if spread > limit:
        return refuse(f"the force on a foot in the air varies by {spread:.1f} N (at most {limit:.1f} N)", details)
    offsets = wrenches.mean(axis=0)  # (2, 6)
    for foot, row in zip(FOOT_NAMES, offsets, strict=True):
        channels = zip(("fx", "fy", "fz", "tx", "ty", "tz"), row, strict=True)
        details |= {f"{foot}_{channel}": float(value) for channel, value in channels}
    text = f"offsets in the air, the largest force {np.abs(offsets[:, :3]).max():.2f} N"
    # gains that were found with other offsets made up for the difference
    return accept(text, details, replace(base, wrench_offsets=offsets, force_gains=np.ones(len(FOOT_NAMES))))


def _gains(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig,
    details: dict[str, float],
) -> Outcome:  # fmt: skip
    weight = model.mass * config.gravity
    still = [w for w in windows if w.speed < config.rest.joint_speed]
    details["time_still"] = duration(still, config.window)
    if details["time_still"] < config.feet.min_time:
        return refuse(
            f"the robot moves: {details['time_still']:.2f} s of {details['time_standing']:.2f} s on both feet at rest, "
            f"at least {config.feet.min_time:g} s needed",
            details,
        )
    loads = np.array([w.loads for w in still]) - base.wrench_offsets[:, 2]  # (k, 2)
    spread = float(loads.sum(axis=1).std())
    details["load_spread"] = spread
    if spread > config.feet.stand_spread * weight:
        return refuse(f"the load on both feet varies by {spread:.1f} N: the robot is not at rest", details)
    shares = loads[:, 0] / loads.sum(axis=1)
    shift = details["shift"] = float(np.ptp(shares))
    apart = shift >= config.feet.min_shift
    columns = loads if apart else loads.sum(axis=1, keepdims=True)
    sigma = config.feet.load_sigma * weight
    n = columns.shape[1]
    normal = columns.T @ columns / sigma**2 + np.eye(n) / config.feet.gain_prior**2
    right = columns.T @ np.full(len(still), weight) / sigma**2 + np.ones(n) / config.feet.gain_prior**2
    gains = np.broadcast_to(np.linalg.solve(normal, right), (2,)).copy()
    details |= {f"{foot}_gain": float(gain) for foot, gain in zip(FOOT_NAMES, gains, strict=True)}
    details["load_error"] = float((loads @ gains).mean() - weight)
    how = "of each foot" if apart else f"of both feet together (the load moved by {shift:.2f} only)"
    text = f"gain {how} from the weight of {weight:.0f} N: {gains[0]:.4f}, {gains[1]:.4f}"
    return accept(text, details, replace(base, force_gains=gains))
