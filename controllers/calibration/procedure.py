"""What a calibration over the graph goes through: wait, collect, have the robot move, give up when need be."""

from __future__ import annotations

from enum import Enum

from controllers.calibration.config import CalibrationConfig
from controllers.calibration.session import CalibrationJob, CalibrationSession
from models.calibration import Calibration
from models.robot_model import RobotModel
from models.types import CommandReply, SensorData

STANDING, MOVING, HANGING = "stand", "motion", "hanging"
"""Situations of the robot that matter here; any other one is named in a refusal."""

MOTIONS = {"joints": "calibrate_joints", "feet": "calibrate_feet"}
"""Motions that a standing robot needs, by what is calibrated."""


class Stage(Enum):
    """Where a calibration is."""

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
    joints the motion ``calibrate_joints``    refused: it takes a jig
    ====== ================================== =============================

    The robot's situation must stay what it was, but for the motion asked for: 'stand', 'motion', 'stand'.

    Args:
        model: The robot.
        config: Bounds; the packaged ``calibration.yaml`` when None.

    Attributes:
        problem: Why the calibration was given up; empty while it goes on.
    """

    def __init__(self, model: RobotModel, config: CalibrationConfig | None = None) -> None:
        self._session = CalibrationSession(model, config)
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
        """Begin a calibration, or say why not.

        Args:
            what: 'imu', 'joints' or 'feet'.
            situation: 'stand' on active drivers, 'hanging', or what else the robot does.
        """
        if situation not in (STANDING, HANGING):
            reason = f"calibration of '{what[:32]}' refused while the robot is '{situation}': stand or hang first"
            return CommandReply(False, reason)
        if what == "joints" and situation == HANGING:
            return CommandReply(False, "calibration of 'joints' refused in the air: it needs both soles on the floor")
        reply = self._session.start(what)
        if reply.accepted:
            self.problem, self._begun_in = "", situation
            self._motion = MOTIONS.get(what, "") if situation == STANDING else ""
            self._named = self._done = self._ask = False
            self._enter(Stage.SETTLING)
        return reply

    def end(self) -> None:
        """Forget the calibration that runs."""
        self._session.cancel()
        self._stage, self.problem = Stage.IDLE, ""

    def job(self, base: Calibration) -> CalibrationJob:
        """What was measured; ends the calibration."""
        job = self._session.job(base)
        self.end()
        return job

    def take_motion(self) -> str:
        """Name of a motion to ask the supervisor for, handed out once; empty when there is none."""
        motion, self._ask = self._motion if self._ask else "", False
        return motion

    def add(self, sensors: SensorData) -> None:
        """Take one raw sample."""
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
        """Told whenever the robot's situation changes."""
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
        """Told of every request for a motion: its name and a number, or 'stop'."""
        if self._stage not in (Stage.ASKED, Stage.MOVING, Stage.MOVED) or self.problem:
            return
        name = request.partition(" ")[0]
        if name == self._motion and self._stage is Stage.ASKED:
            self._named = True
        else:
            self._give_up(f"the motion '{name[:32]}' was asked for")

    def on_motion(self, word: str, reason: str = "") -> None:
        """Told what becomes of a motion: 'running', 'done', or 'refused' with the request that was, and why."""
        request, _, why = reason.partition(": ")
        if word == "refused":
            if self._stage is Stage.ASKED and request.partition(" ")[0] == self._motion:
                self._give_up(f"the motion '{self._motion}' was refused: {why}")
        elif word == "running" and self._stage is Stage.ASKED and self._named:
            self._session.clear()
            self._enter(Stage.MOVING)
        elif word == "done" and self._stage in (Stage.MOVING, Stage.MOVED):
            self._done = True
            if self._stage is Stage.MOVED:
                self._enter(Stage.READY)

    def wait(self, dt: float) -> None:
        """Let a time [s] of the machine's clock pass."""
        if self._stage in (Stage.IDLE, Stage.READY) or self.problem:
            return
        self._silent += dt
        self._waited += dt
        limits = self.config.procedure
        longest = {Stage.ASKED: limits.plan, Stage.MOVING: limits.motion, Stage.MOVED: limits.word}.get(self._stage)
        if self._silent > limits.silence:
            self._give_up(f"no complete sample for {limits.silence:g} s")
        elif longest is not None and self._waited > longest:
            self._give_up(f"{self._stage.value} '{self._motion}' took more than {longest:g} s")

    def _enter(self, stage: Stage) -> None:
        self._stage = stage
        self._begin_t = None
        self._silent = self._waited = 0.0

    def _give_up(self, reason: str) -> None:
        self.problem = f"calibration of '{self._session.what}' given up: {reason}"
