"""Calibration of the encoders in a jig: the true posture is known, so the offset is what is read beyond it."""

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


def calibrate_in_jig(
    windows: Sequence[Window], model: RobotModel, base: Calibration, config: CalibrationConfig, max_offset: float
) -> Outcome:
    """Offsets of all joints from the jig postures that the profile names: o = mean over postures of (q_m - q_jig).

    Each window at rest belongs to the posture from which no joint is further than ``max_offset``; windows that belong
    to none are the way between two postures.

    Args:
        windows: Raw samples, averaged, in at least ``min_postures`` of the postures, in any order.
        model: The robot; its profile names the postures.
        base: What the other sensors' part of the result is taken from.
        config: Bounds.
        max_offset: Largest plausible offset [rad].

    Returns:
        The calibration, or the reason of the refusal. Details: the offset of each joint by name [rad],
        ``time_<posture>`` [s], ``disagreement`` between postures [rad].
    """
    names = model.profile.jig_postures
    seen: dict[str, list[Window]] = {name: [] for name in names}
    for window in windows:
        for name in names:
            if window.speed < config.rest.joint_speed and np.abs(window.q - model.posture(name)).max() <= max_offset:
                seen[name].append(window)
    details = {f"time_{name}": duration(found, config.window) for name, found in seen.items()}
    kept = {name: found for name, found in seen.items() if details[f"time_{name}"] >= config.posture.min_time}
    if len(kept) < config.posture.min_postures:
        return refuse(_missing(windows, model, config, kept, max_offset), details)
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
    max_offset: float,
) -> str:
    """Why there are too few postures: the joint that was furthest off in the posture that came closest."""
    wanted = [name for name in model.profile.jig_postures if name not in kept]
    text = (
        f"the robot must rest in {config.posture.min_postures} jig postures for {config.posture.min_time:g} s each; "
        f"missing: {', '.join(wanted)}"
    )
    if windows:
        errors = [(np.abs(w.q - model.posture(name)), name) for w in windows for name in wanted]
        error, name = min(errors, key=lambda item: float(item[0].max()))
        worst = int(error.argmax())
        if error[worst] > max_offset:
            joint = model.joint_names[worst]
            text += f"; closest to '{name}', joint '{joint}' was {error[worst]:.3f} rad off (at most {max_offset:g})"
        else:
            text += f"; '{name}' was met, but not at rest for long enough"
    return text
