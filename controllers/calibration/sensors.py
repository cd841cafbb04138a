"""Calibration of single sensors: IMU at rest, foot sensors from the weight, encoders in a jig."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from controllers.calibration.config import CalibrationConfig
from controllers.calibration.windows import Outcome, Window, accept, duration, named, refuse, unrest
from models.calibration import Calibration
from models.constants import FOOT_NAMES
from models.robot_model import RobotModel
from models.types import Vector


def calibrate_imu(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig
) -> Outcome:
    r"""Gyro bias, and the component of the accelerometer bias along gravity.

    .. math::
        b_w = \bar w - \bar w_k, \qquad u = \bar f / |\bar f|, \qquad b_f = (|\bar f| - g)\, u

    The means are of angular rate w and specific force f at rest. w_k is the rate of the IMU relative to the left sole,
    from the encoders, while both feet bear the robot (else 0): a robot with a biased gyro leans slowly while it stands.
    At one attitude, the accelerometer bias across gravity cannot be distinguished from a tilt of the IMU, nor a scale
    error from a bias. They stay 0 and are left to the state estimator. ``base`` supplies the calibration of the other
    sensors.

    Returns:
        The calibration, or the reason of the refusal. Details: ``time`` [s], ``samples``, the details of ``unrest``,
        ``turning_{x,y,z}`` (w_k) and ``gyro_bias_{x,y,z}`` [rad/s], ``gravity_{x,y,z}`` (u, in the IMU frame),
        ``accel_norm`` [m/s^2], ``tilt`` of the IMU [rad].

    Assumptions:
        The ground under the robot does not rotate: a slow, steady rotation looks like a bias.
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
    """Mean angular rate of the IMU relative to the left sole, in the IMU frame (3,) [rad/s]; 0 if a foot hangs."""
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


def calibrate_feet(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig
) -> Outcome:
    r"""Offsets from windows in the air, gains from windows at rest on both feet; either or both.

    .. math::
        o_i = \bar W_i \;\text{(air)}, \qquad
        \min_{g} \sum_k \Big(\frac{\sum_i g_i (f_{ik} - o_i) - m g}{\sigma_m}\Big)^2
                + \sum_i \Big(\frac{g_i - 1}{\sigma_g}\Big)^2 \;\text{(standing)}

    W_i is the wrench on foot i, f_ik its measured normal force in window k [N], m the mass of the model. The gains
    differ only if the load moves from one foot to the other by ``min_shift``; otherwise both feet get the same gain.
    New offsets reset the gains to 1, because the old gains belong to the old offsets. Without a window in the air, the
    offsets of ``base`` are used.

    Returns:
        The calibration, or the reason of the refusal. Details: ``time_air``, ``time_standing`` [s], offsets
        ``left_fx`` ... ``right_tz`` [N, N.m], ``left_gain``, ``right_gain`` [-], ``shift`` [-].

    Assumptions:
        The robot carries no load and touches only the floor. The floor is level. No mass is below the sensors.
    """
    weight = model.mass * config.gravity
    loads = [float(np.abs(w.loads).sum()) for w in windows]
    air = [w for w, load in zip(windows, loads, strict=True) if load < config.feet.air_load * weight]
    standing = [w for w, load in zip(windows, loads, strict=True) if load > config.feet.stand_load * weight]
    times = {"time_air": duration(air, config.window), "time_standing": duration(standing, config.window)}
    details, found, parts = {**times, "weight": weight}, base, list[str]()
    for time, part, law in zip(times.values(), (air, standing), (_offsets, _gains), strict=True):
        if time < config.feet.min_time:
            continue
        result = law(part, model, found, config, details)
        if result.calibration is None:
            return result
        found, details = result.calibration, result.reply.details
        parts.append(result.reply.reason)
    return accept("; ".join(parts), details, found) if parts else refuse(_neither(loads, weight, config), details)


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
    # the old gains compensate for the old offsets
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


def calibrate_in_jig(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig, offset_max: float
) -> Outcome:
    """Offsets of all joints from the jig postures of the profile: o = mean over postures of (q_m - q_jig).

    A window at rest belongs to a posture if every joint is within ``offset_max`` [rad], the largest plausible offset.
    Other windows are motions between postures. At least ``min_postures`` postures must occur, in any order. ``base``
    supplies the calibration of the other sensors. Returns the calibration, or the reason of the refusal. Details: the
    offset of each joint by name [rad], ``time_<posture>`` [s], ``disagreement`` between postures [rad].
    """
    names = model.profile.jig_postures
    seen: dict[str, list[Window]] = {name: [] for name in names}
    for window in windows:
        for name in names:
            if window.speed < config.rest.joint_speed and np.abs(window.q - model.posture(name)).max() <= offset_max:
                seen[name].append(window)
    details = {f"time_{name}": duration(found, config.window) for name, found in seen.items()}
    kept = {name: found for name, found in seen.items() if details[f"time_{name}"] >= config.posture.min_time}
    if len(kept) < config.posture.min_postures:
        return refuse(_missing(windows, model, config, kept, offset_max), details)
    offsets = []
    for name, found in kept.items():
        moved, numbers = unrest(found, model, config.rest)
        if moved:
            return refuse(f"the robot moves in posture '{name}': {moved}", details | numbers)
        offsets.append(np.mean([w.q for w in found], axis=0) - model.posture(name))
    spread = np.ptp(offsets, axis=0)  # (nj,)
    worst = int(spread.argmax())
    details["disagreement"] = float(spread[worst])
    if spread[worst] > config.posture.agreement:
        return refuse(
            f"joint '{model.joint_names[worst]}': the postures {', '.join(kept)} give offsets that differ by "
            f"{spread[worst]:.4f} rad (at most {config.posture.agreement:g}); one of them is not the jig's",
            details,
        )
    offset = np.mean(offsets, axis=0)
    details |= {name: float(value) for name, value in zip(model.joint_names, offset, strict=True)}
    largest = int(np.abs(offset).argmax())
    return accept(
        f"offsets of all {model.nj} joints from {len(kept)} postures, the largest {offset[largest]:.4f} rad at "
        f"'{model.joint_names[largest]}'",
        details,
        replace(base, encoder_offsets=offset),
    )


def _missing(
    windows: Sequence[Window],
    model: RobotModel,
    config: CalibrationConfig,
    kept: dict[str, list[Window]],
    offset_max: float,
) -> str:
    """Reason for too few postures: the closest missing posture, and the joint with the largest error in it."""
    missing = [name for name in model.profile.jig_postures if name not in kept]
    text = (
        f"the robot must rest in {config.posture.min_postures} jig postures for {config.posture.min_time:g} s each; "
        f"missing: {', '.join(missing)}"
    )
    if windows:
        errors = [(np.abs(w.q - model.posture(name)), name) for w in windows for name in missing]
        error, name = min(errors, key=lambda item: float(item[0].max()))
        worst = int(error.argmax())
        if error[worst] > offset_max:
            joint = model.joint_names[worst]
            text += f"; closest to '{name}', joint '{joint}' was {error[worst]:.3f} rad off (at most {offset_max:g})"
        else:
            text += f"; '{name}' was met, but not at rest for long enough"
    return text
