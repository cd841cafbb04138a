"""Calibration from start to outcome: sample collection and evaluation, in a closed loop or across nodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from msgspec import structs

from controllers.calibration.closed_chain import calibrate_closed_chain
from controllers.calibration.config import CalibrationConfig
from controllers.calibration.sensors import calibrate_feet, calibrate_imu, calibrate_in_jig
from controllers.calibration.windows import Outcome, Window, WindowAverager, refuse
from models.calibration import Calibration, CalibrationLimits, implausible
from models.config import default_config
from models.robot_model import RobotModel
from models.status import MotionState, MotionStatus
from models.types import CommandReply, SensorData

WHATS = ("imu", "joints", "feet")  #: Parts that can be calibrated


@dataclass(frozen=True, slots=True)
class CalibrationJob:
    """All inputs of ``solve``, so that another process can run it."""

    what: str  # 'imu', 'joints' or 'feet'
    windows: tuple[Window, ...]
    unusable: int  # number of excluded samples
    base: Calibration  # present calibration; the result replaces the part that was calibrated
    config: CalibrationConfig
    limits: CalibrationLimits  # plausible corrections


class CalibrationSession:
    """Collects raw samples and computes a calibration from them; deterministic, no clock, no files.

    The method for ``joints`` depends on the load on the feet: the closed chain through both soles when the robot
    stands, the jig postures of the profile when it hangs. A robot without foot sensors cannot measure the load, so
    ``start`` has the argument ``standing``; ``feet`` is refused. ``what`` is the part under calibration, or empty.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self.config = default_config(CalibrationConfig, "controllers", "calibration")
        self._limits = default_config(CalibrationLimits, "models", "calibration")
        self._averager = WindowAverager(model, self.config.window)
        self._fitted = model.profile.sensors.feet.fitted
        self._assumed = np.zeros((2, 6))  # assumed wrenches without foot sensors [N, N.m]
        self.what = ""

    @property
    def elapsed(self) -> float:
        """Time covered by the collected windows [s]."""
        return len(self._averager.windows) * self.config.window

    def start(self, what: str, *, standing: bool = True) -> CommandReply:
        """Start collecting for 'imu', 'joints' or 'feet'; refused for other names and while a calibration runs.

        ``standing`` is whether both feet bear the robot; used only without foot sensors.
        """
        if what not in WHATS:
            return CommandReply(False, f"calibration of {what[:32]!r} refused; known: {', '.join(WHATS)}")
        if self.what:
            return CommandReply(False, f"calibration of '{what}' refused: '{self.what}' is being calibrated")
        if what == "feet" and not self._fitted:
            return CommandReply(False, "calibration of 'feet' refused: this robot has no foot sensors")
        self.what = what
        self._assumed[:, 2] = 0.5 * self._model.mass * self.config.gravity if standing else 0.0
        self._averager.clear()
        return CommandReply(True, f"collecting samples for '{what}'")

    def cancel(self) -> None:
        """Cancel the running calibration."""
        self.what = ""
        self._averager.clear()

    def add(self, sensors: SensorData) -> None:
        """Add one raw sample (not corrected by any calibration); ignored when idle."""
        if self.what:
            self._averager.add(sensors if self._fitted else structs.replace(sensors, wrenches=self._assumed))

    def clear(self) -> None:
        """Discard the samples; the calibration continues."""
        self._averager.clear()

    def job(self, base: Calibration) -> CalibrationJob:
        """End the calibration and return the input of ``solve``; ``base`` is the present calibration."""
        windows, unusable = tuple(self._averager.windows), self._averager.unusable
        job = CalibrationJob(self.what, windows, unusable, base, self.config, self._limits)
        self.cancel()
        return job

    def finish(self, base: Calibration) -> Outcome:
        """End the calibration; returns the new one without a time stamp, or the reason of the refusal, with details."""
        if not self.what:
            return refuse("no calibration is running: start one first", {})
        return solve(self.job(base), self._model)


def solve(job: CalibrationJob, model: RobotModel) -> Outcome:
    """The new calibration without a time stamp, or the reason of the refusal; takes seconds for ``joints``."""
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


#: Situations of the robot that the procedure handles; a refusal names any other
STANDING, MOVING, HANGING = "stand", "motion", "hanging"
#: Motions of a standing robot, by the part under calibration
MOTIONS = {"joints": "calibrate_joints", "feet": "calibrate_feet"}


class Stage(Enum):
    """Stage of a calibration."""

    IDLE = "idle"
    SETTLING = "settling"
    RESTING = "collecting at rest"
    ASKED = "waiting for the motion"
    MOVING = "collecting in motion"
    MOVED = "waiting for the end of the motion"
    READY = "ready"


class CalibrationProcedure:
    """Drives a ``CalibrationSession``; deterministic, no clock, no topics.

    ====== ================================== =============================
    what   standing                           hanging
    ====== ================================== =============================
    imu    at rest                            at rest
    feet   the motion ``calibrate_feet``      at rest
    joints the motion ``calibrate_joints``    refused: needs a jig
    ====== ================================== =============================

    The situation of the robot must not change, except for the requested motion: 'stand', 'motion', 'stand'. ``problem``
    is the reason of an aborted calibration, empty otherwise.
    """

    def __init__(self, model: RobotModel) -> None:
        self._session = CalibrationSession(model)
        self.config = self._session.config
        self.problem = ""
        self._stage = Stage.IDLE
        self._motion = self._begun_in = ""
        self._named = self._done = self._ask = False
        self._begin_t: float | None = None
        self._silent = self._waited = 0.0

    @property
    def ready(self) -> bool:
        """Whether ``job`` may be called."""
        return self._stage is Stage.READY and not self.problem

    def begin(self, what: str, situation: str) -> CommandReply:
        """Begin 'imu', 'joints' or 'feet'; refused unless ``situation`` is 'stand' (drivers active) or 'hanging'."""
        if situation not in (STANDING, HANGING):
            reason = (
                f"calibration of '{what[:32]}' refused while the robot is '{situation}': the robot must stand or hang"
            )
            return CommandReply(False, reason)
        if what == "joints" and situation == HANGING:
            return CommandReply(False, "calibration of 'joints' refused in the air: both soles must be on the floor")
        reply = self._session.start(what, standing=situation == STANDING)
        if reply.accepted:
            self.problem, self._begun_in = "", situation
            self._motion = MOTIONS.get(what, "") if situation == STANDING else ""
            self._named = self._done = self._ask = False
            self._enter(Stage.SETTLING)
        return reply

    def end(self) -> None:
        """End the calibration without a result."""
        self._session.cancel()
        self._stage, self.problem = Stage.IDLE, ""

    def job(self, base: Calibration) -> CalibrationJob:
        """Input of ``solve``; ends the calibration."""
        job = self._session.job(base)
        self.end()
        return job

    def take_motion(self) -> str:
        """Name of a motion to request from the supervisor, returned once; empty if none."""
        motion, self._ask = self._motion if self._ask else "", False
        return motion

    def add(self, sensors: SensorData) -> None:
        """Add one raw sample."""
        if self._stage is Stage.IDLE or self.problem:
            return
        self._silent = 0.0
        self._begin_t = sensors.t if self._begin_t is None else self._begin_t
        elapsed, config, what = sensors.t - self._begin_t, self.config, self._session.what
        if self._stage is Stage.SETTLING and elapsed >= config.settle:
            self._session.clear()
            self._ask = bool(self._motion)
            self._enter(Stage.ASKED if self._motion else Stage.RESTING)
        elif self._stage in (Stage.RESTING, Stage.MOVING):
            self._session.add(sensors)
            rest = config.imu.time if what == "imu" else config.feet.time
            if self._stage is Stage.RESTING and elapsed >= rest:
                self._enter(Stage.READY)

    def on_situation(self, situation: str) -> None:
        """Handle a change of the robot's situation."""
        stage = self._stage
        if stage in (Stage.IDLE, Stage.READY) or self.problem:
            return
        if stage is Stage.MOVING and situation == STANDING:
            self._enter(Stage.READY if self._done else Stage.MOVED)
        elif stage is Stage.ASKED and self._named and situation == STANDING:
            self._give_up(f"the motion '{self._motion}' did not begin")
        elif situation != self._begun_in and not (stage in (Stage.ASKED, Stage.MOVING) and situation == MOVING):
            self._give_up(f"the robot is '{situation}'")

    def on_request(self, request: str) -> None:
        """Handle a motion request of any client: name and number, or 'stop'."""
        if self._stage not in (Stage.ASKED, Stage.MOVING, Stage.MOVED) or self.problem:
            return
        name = request.partition(" ")[0]
        if name == self._motion and self._stage is Stage.ASKED:
            self._named = True
        else:
            self._give_up(f"the motion '{name[:32]}' was requested meanwhile")

    def on_motion(self, status: MotionStatus) -> None:
        """Handle the status of the requested motion."""
        if status.state is MotionState.REFUSED:
            if self._stage is Stage.ASKED and status.request.partition(" ")[0] == self._motion:
                self._give_up(f"the motion '{self._motion}' was refused: {status.reason}")
        elif status.state is MotionState.RUNNING and self._stage is Stage.ASKED and self._named:
            self._session.clear()
            self._enter(Stage.MOVING)
        elif status.state is MotionState.DONE and self._stage in (Stage.MOVING, Stage.MOVED):
            self._done = True
            if self._stage is Stage.MOVED:
                self._enter(Stage.READY)
        elif status.state is MotionState.ENDED and self._stage in (Stage.MOVING, Stage.MOVED) and not self.problem:
            self._give_up(f"the motion '{self._motion}' {status}")

    def wait(self, dt: float) -> None:
        """Advance the timeouts by ``dt`` [s] on the machine's clock."""
        if self._stage in (Stage.IDLE, Stage.READY) or self.problem:
            return
        self._silent += dt
        self._waited += dt
        limits = self.config.procedure
        longest = {Stage.ASKED: limits.plan, Stage.MOVING: limits.motion, Stage.MOVED: limits.completion}.get(
            self._stage
        )
        if self._silent > limits.silence:
            self._give_up(f"no complete sample for {limits.silence:g} s")
        elif longest is not None and self._waited > longest:
            self._give_up(f"{self._stage.value} '{self._motion}' took more than {longest:g} s")

    def _enter(self, stage: Stage) -> None:
        self._stage = stage
        self._begin_t = None
        self._silent = self._waited = 0.0

    def _give_up(self, reason: str) -> None:
        self.problem = f"calibration of '{self._session.what}' aborted: {reason}"
