"""Motor drivers: which modes and commands they accept, and ``JointServo`` on the clock of joint samples."""

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

TOO_OLD = "commands too old"  #: Counter of commands whose sensors are older than ``command_age_max``


def follow_mode(servo: JointServo, before: Mode, mode: Mode) -> None:
    """Arm, damp or switch off the drivers by a change of mode; ``CommandError`` for off while they are active.

    Drivers that damped because of a fault are armed only by a change from a mode without motion to one with motion.
    """
    if mode is Mode.OFF and servo.state is ServoState.ACTIVE:
        raise CommandError("mode 'off' refused: the robot would drop; 'damp' comes first")
    if mode in ACTIVE_MODES:
        if before not in ACTIVE_MODES:
            servo.arm()
    elif mode is Mode.DAMP:
        servo.damp()
    else:
        servo.off()


def check_stamp(stamp: int, last: int, now: int, age_max: int, counters: Counter[str]) -> None:
    """Check a command's stamp, that of the sensors it answers (0: now), against the last one and the newest [ns].

    ``counters`` counts commands older than ``age_max``. Raises ``MessageError`` for a stamp that is not newer than the
    last command's, not yet due, or too old.
    """
    if stamp and not last < stamp <= now:
        raise MessageError(f"header.stamp: {stamp} ns is not after {last} ns or not yet due")
    if stamp and now - stamp > age_max:
        counters[TOO_OLD] += 1
        raise MessageError(f"header.stamp: {stamp} ns is {now - stamp} ns old, more than {age_max} ns")


@dataclass(frozen=True, slots=True, config=STRICT)
class MotorDriverConfig:
    """Schema of ``controllers/config/motor_driver.yaml``."""

    command_age_max: Positive  #: age of the sensors a command answers above which it is refused [s]
    gap_max: Positive  #: largest step of the joints' stamp accepted at once [s]
    step_max: Positive  #: step that the torque rate is counted over at most, after lost samples [s]
    sensor_timeout: Positive  #: silence of the joints after which it damps [s]


class MotorDriver:
    """``JointServo`` on the clock of the joint samples, with validation of the commands.

    Each joint sample gives one vector of torques. A command is validated by the stamp of the sensors that it answers,
    its limits and, for a trajectory, its start. No torque steps by more than the drives' rate times ``step_max``,
    whatever the command and however many samples were lost.

    A mode with motion that was there before the drivers does not arm them: the start of a process must not move motors.
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
        """Apply the supervisor's mode; ``CommandError`` for off while active, and for motion as the first mode."""
        before = self._mode
        if before is None and mode in ACTIVE_MODES:
            self._mode = mode
            raise CommandError(f"mode '{mode.value}' was there before the drivers: 'damp' comes first")
        follow_mode(self.servo, before or Mode.OFF, mode)
        self._mode = mode

    def sample(self, stamp: int, q: Vector, v: Vector) -> Vector:
        """Torques (nj,) [N.m] for joints (nj,) measured at a stamp [ns]; ``MessageError`` for an unusable stamp."""
        step = self._stamps.step(stamp)
        if step > self._gap_max:
            self._counters["gaps bridged"] += 1
        self.servo.step(stamp / NANOSECONDS, q, v, min(step / NANOSECONDS, self._config.step_max))
        return self.servo.torque

    def command(self, stamp: int, command: JointCommand | JointTrajectory) -> bool:
        """Accept a command computed from the sensors of a stamp [ns], 0 for now; whether it is in force."""
        now = self._stamps.last
        if now is None:
            return False
        check_stamp(stamp, self._last_command, now, self._age_max, self._counters)
        accepted = self.servo.command(command, now / NANOSECONDS)
        if accepted:
            self._last_command = stamp or self._last_command
        return accepted

    def damp_on_silence(self) -> bool:
        """Damp because no joint sample came for ``sensor_timeout``; returns whether the servo was active."""
        if self.servo.state is not ServoState.ACTIVE:
            return False
        self._counters["joint silences"] += 1
        self.servo.damp()
        return True
