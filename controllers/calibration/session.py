"""One calibration at a time: start, samples in, answer out. A closed loop drives it, or ``CalibrationProcedure``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from controllers.calibration.closed_chain import calibrate_closed_chain
from controllers.calibration.config import CalibrationConfig
from controllers.calibration.feet import calibrate_feet
from controllers.calibration.imu import calibrate_imu
from controllers.calibration.known_posture import calibrate_in_jig
from controllers.calibration.outcome import Outcome, refuse
from controllers.calibration.windows import Window, WindowAverager
from models.calibration import Calibration
from models.calibration_limits import CalibrationLimits, implausible
from models.config import default_config
from models.robot_model import RobotModel
from models.types import CommandReply, SensorData

WHATS = ("imu", "joints", "feet")
"""What can be calibrated."""


@dataclass(frozen=True, slots=True)
class CalibrationJob:
    """Everything that the numbers follow from, so that another process can work them out.

    Attributes:
        what: 'imu', 'joints' or 'feet'.
        windows: What was measured.
        unusable: Samples that were left out.
        base: Present calibration; the result replaces the part that was calibrated.
        config: Bounds.
        limits: Plausible corrections.
    """

    what: str
    windows: tuple[Window, ...]
    unusable: int
    base: Calibration
    config: CalibrationConfig
    limits: CalibrationLimits


class CalibrationSession:
    """Collects raw samples and turns them into a calibration; deterministic, no clock, no files.

    ``joints`` looks at the feet: when they carried the robot it closes the chain through both soles, and when they
    hung it compares with the jig postures of the profile.

    Args:
        model: The robot.
        config: Bounds; the packaged ``calibration.yaml`` when None.
        limits: Plausible corrections; those of the packaged ``models/config/calibration.yaml`` when None.

    Attributes:
        what: What is being calibrated; empty when nothing is.
    """

    def __init__(
        self, model: RobotModel, config: CalibrationConfig | None = None, limits: CalibrationLimits | None = None
    ) -> None:
        self._model = model
        self.config = config or default_config(CalibrationConfig, "controllers", "calibration")
        self._limits = limits or default_config(CalibrationLimits, "models", "calibration")
        self._averager = WindowAverager(model, self.config.window)
        self.what = ""

    @property
    def elapsed(self) -> float:
        """Time that the collected windows cover [s]."""
        return len(self._averager.windows) * self.config.window

    def start(self, what: str) -> CommandReply:
        """Begin to collect; refused while a calibration runs and for anything but imu, joints and feet."""
        if what not in WHATS:
            return CommandReply(False, f"calibration of {what[:32]!r} refused: known are {', '.join(WHATS)}")
        if self.what:
            return CommandReply(False, f"calibration of '{what}' refused: '{self.what}' is being calibrated")
        self.what = what
        self._averager.clear()
        return CommandReply(True, f"collecting samples for '{what}'")

    def cancel(self) -> None:
        """Forget the calibration that runs."""
        self.what = ""
        self._averager.clear()

    def add(self, sensors: SensorData) -> None:
        """Take one raw sample (not corrected by any calibration); ignored when nothing is being calibrated."""
        if self.what:
            self._averager.add(sensors)

    def clear(self) -> None:
        """Forget the samples, not what is being calibrated."""
        self._averager.clear()

    def job(self, base: Calibration) -> CalibrationJob:
        """End the calibration, leaving its numbers to ``solve``.

        Args:
            base: Present calibration; the result replaces the part that was calibrated.

        Returns:
            What ``solve`` needs.
        """
        windows, unusable = tuple(self._averager.windows), self._averager.unusable
        job = CalibrationJob(self.what, windows, unusable, base, self.config, self._limits)
        self.cancel()
        return job

    def finish(self, base: Calibration) -> Outcome:
        """End the calibration.

        Args:
            base: Present calibration; the result replaces the part that was calibrated.

        Returns:
            The new calibration without a time stamp, or the reason of the refusal; numbers in both cases.
        """
        if not self.what:
            return refuse("nothing is being calibrated: start first", {})
        return solve(self.job(base), self._model)


def solve(job: CalibrationJob, model: RobotModel) -> Outcome:
    """Work out a calibration; takes seconds for ``joints``.

    Args:
        job: What was measured.
        model: The robot.

    Returns:
        The new calibration without a time stamp, or the reason of the refusal; numbers in both cases.
    """
    outcome = _solve(job, model)
    outcome.reply.details["samples_unusable"] = float(job.unusable)
    if outcome.calibration is not None:
        problem = implausible(outcome.calibration, model, job.limits)
        if problem:
            return refuse(f"implausible: {problem}", outcome.reply.details)
    return outcome


def _solve(job: CalibrationJob, model: RobotModel) -> Outcome:
    windows, config, base = job.windows, job.config, job.base
    if not windows:
        return refuse(f"too few samples: no window of {config.window:g} s was filled ({job.unusable} unusable)", {})
    if job.what == "imu":
        return calibrate_imu(windows, model, base, config)
    if job.what == "feet":
        return calibrate_feet(windows, model, base, config)
    load, weight = _load(windows), model.mass * config.gravity
    if load < config.feet.air_load * weight:
        return calibrate_in_jig(windows, model, base, config, job.limits.encoder_offset)
    if load > config.feet.stand_load * weight:
        return calibrate_closed_chain(windows, model, base, config)
    reason = (
        f"the feet carry {load:.0f} N: neither standing on both soles (above "
        f"{config.feet.stand_load * weight:.0f} N) nor in the jig (below {config.feet.air_load * weight:.0f} N)"
    )
    return refuse(reason, {"load": load, "weight": weight})


def _load(windows: Sequence[Window]) -> float:
    """Mean normal force on both feet [N]."""
    return float(np.mean([window.loads.sum() for window in windows]))
