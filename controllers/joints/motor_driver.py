"""Motor drivers: validation of modes and commands, and ``JointServo`` on the clock of the joint samples."""

from collections import Counter

from pydantic.dataclasses import dataclass

from controllers.estimation.stamps import StampFilter
from controllers.joints.joint_servo import JointServo, JointServoConfig, ServoState
from controllers.safety.supervisor import ACTIVE_MODES
from models.config import STRICT, Positive
from models.constants import NANOSECONDS
from models.errors import CommandError, MessageError
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory, Mode, Vector

TOO_OLD = "commands too old"  #: Counter of commands from sensor samples older than ``command_age_max``


def follow_mode(servo: JointServo, before: Mode, mode: Mode) -> None:
    """Arm, damp or switch off the drivers when the mode changes; ``CommandError`` for ``off`` while they are active.

    Only a change from an inactive to an active mode arms the drivers, also after a fault.
    """
    if mode is Mode.OFF and servo.state is ServoState.ACTIVE:
        raise CommandError("mode 'off' refused: the robot would drop; request 'damp' first")
    if mode in ACTIVE_MODES:
        if before not in ACTIVE_MODES:
            servo.arm()
    elif mode is Mode.DAMP:
        servo.damp()
    else:
        servo.off()


def check_stamp(stamp: int, last: int, now: int, age_max: int, counters: Counter[str]) -> None:
    """Check the stamp of a command, which is the stamp of its sensor sample (0: now).

    ``last`` is the stamp of the last command, ``now`` of the newest sample; all in [ns]. ``counters`` counts commands
    older than ``age_max``. Raises ``MessageError`` when ``stamp`` is not after ``last``, after ``now``, or too old.
    """
    if stamp and not last < stamp <= now:
        raise MessageError(f"header.stamp: {stamp} ns is not after {last} ns, or is in the future")
    if stamp and now - stamp > age_max:
        counters[TOO_OLD] += 1
        raise MessageError(f"header.stamp: {stamp} ns is {now - stamp} ns old, more than {age_max} ns")


@dataclass(frozen=True, slots=True, config=STRICT)
class MotorDriverConfig:
    """Schema of ``controllers/config/motor_driver.yaml``."""

    command_age_max: Positive  #: age of the sensor sample of a command above which the command is refused [s]
    gap_max: Positive  #: largest step of the joints' stamp accepted at once [s]
    step_max: Positive  #: longest time step of the torque-rate limit, for use after lost samples [s]
    sensor_timeout: Positive  #: time without joint samples after which the driver damps [s]


class MotorDriver:
    """``JointServo`` on the clock of the joint samples, with validation of the commands.

    Each joint sample yields one vector of torques. A command is validated by the stamp of its sensor sample, its limits
    and, for a trajectory, its start. No torque changes by more than the torque rate times ``step_max`` per sample, for
    any command and any number of lost samples.

    An active mode before the start of the drivers does not arm them, since the start of a process must not move motors.
    ``counters`` counts gaps, silences and commands that are too old; ``servo`` is the law of the drivers.
    """

    def __init__(
        self, model: RobotModel, config: MotorDriverConfig, servo: JointServoConfig | None, counters: Counter[str]
    ) -> None:
        self.servo = JointServo(model, servo)
        self._config, self._counters = config, counters
        self._age_max = round(config.command_age_max * NANOSECONDS)
        self._gap_max = round(config.gap_max * NANOSECONDS)
        self._stamps = StampFilter(self._gap_max)
        self._mode: Mode | None = None
        self._last_command = 0

    def set_mode(self, mode: Mode) -> None:
        """Apply the supervisor's mode; ``CommandError`` for ``off`` while active, and for an active first mode."""
        before = self._mode
        if before is None and mode in ACTIVE_MODES:
            self._mode = mode
            raise CommandError(f"mode '{mode.value}' was active before the drivers started: request 'damp' first")
        follow_mode(self.servo, before or Mode.OFF, mode)
        self._mode = mode

    def sample(self, stamp: int, q: Vector, v: Vector) -> Vector:
        """Torques (nj,) [N.m] for joints (nj,) measured at a stamp [ns]; ``MessageError`` for an invalid stamp."""
        step = self._stamps.step(stamp)
        if step > self._gap_max:
            self._counters["gaps bridged"] += 1
        self.servo.step(stamp / NANOSECONDS, q, v, min(step / NANOSECONDS, self._config.step_max))
        return self.servo.torque

    def command(self, stamp: int, command: JointCommand | JointTrajectory) -> bool:
        """Accept a command for the sensor sample of a stamp [ns], 0 for now; returns whether it is in force."""
        now = self._stamps.last
        if now is None:
            return False
        check_stamp(stamp, self._last_command, now, self._age_max, self._counters)
        accepted = self.servo.command(command, now / NANOSECONDS)
        if accepted:
            self._last_command = stamp or self._last_command
        return accepted

    def damp_on_silence(self) -> bool:
        """Damp when no joint sample arrived for ``sensor_timeout``; returns whether the servo was active."""
        if self.servo.state is not ServoState.ACTIVE:
            return False
        self._counters["joint silences"] += 1
        self.servo.damp()
        return True
