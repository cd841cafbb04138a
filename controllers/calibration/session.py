"""One calibration at a time: start, samples in, answer out. A node or a closed loop drives it."""

from __future__ import annotations

import numpy as np

from controllers.calibration.closed_chain import calibrate_closed_chain
from controllers.calibration.config import CalibrationConfig
from controllers.calibration.feet import calibrate_feet
from controllers.calibration.imu import calibrate_imu
from controllers.calibration.known_posture import calibrate_in_jig
from controllers.calibration.outcome import Outcome, refuse
from controllers.calibration.windows import WindowAverager
from models.calibration import Calibration
from models.calibration_limits import CalibrationLimits, implausible
from models.config import default_config
from models.robot_model import RobotModel
from models.types import CommandReply, SensorData

WHATS = ("imu", "joints", "feet")
"""What can be calibrated."""


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
        self._weight = model.mass * self.config.gravity
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

    def finish(self, base: Calibration) -> Outcome:
        """End the calibration.

        Args:
            base: Present calibration; the result replaces the part that was calibrated.

        Returns:
            The new calibration without a time stamp, or the reason of the refusal; numbers in both cases.
        """
        if not self.what:
            return refuse("nothing is being calibrated: start first", {})
        outcome = self._solve(base)
        outcome.reply.details["samples_unusable"] = float(self._averager.unusable)
        self.cancel()
        if outcome.calibration is not None:
            problem = implausible(outcome.calibration, self._model, self._limits)
            if problem:
                return refuse(f"implausible: {problem}", outcome.reply.details)
        return outcome

    def _solve(self, base: Calibration) -> Outcome:
        windows, model, config = self._averager.windows, self._model, self.config
        if not windows:
            unusable = self._averager.unusable
            return refuse(f"too few samples: no window of {config.window:g} s was filled ({unusable} unusable)", {})
        if self.what == "imu":
            return calibrate_imu(windows, model, base, config)
        if self.what == "feet":
            return calibrate_feet(windows, model, base, config)
        load = float(np.mean([w.loads.sum() for w in windows]))
        if load < config.feet.air_load * self._weight:
            return calibrate_in_jig(windows, model, base, config, self._limits.encoder_offset)
        if load > config.feet.stand_load * self._weight:
            return calibrate_closed_chain(windows, model, base, config)
        reason = (
            f"the feet carry {load:.0f} N: neither standing on both soles (above "
            f"{config.feet.stand_load * self._weight:.0f} N) nor in the jig (below "
            f"{config.feet.air_load * self._weight:.0f} N)"
        )
        return refuse(reason, {"load": load, "weight": self._weight})
