"""Motor drivers of a robot whose joints are somewhere else: joint samples and commands in, torques out."""

from __future__ import annotations

from collections import Counter
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from controllers.driver_orders import check_stamp, follow_mode
from controllers.joint_servo import JointServo, JointServoConfig, ServoState
from controllers.stamp_guard import StampGuard
from controllers.supervisor import ACTIVE_MODES
from models.config import STRICT
from models.constants import NANOSECONDS
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory, Mode, Vector


@dataclass(frozen=True, slots=True, config=STRICT)
class MotorDriverConfig:
    """Schema of ``controllers/config/motor_driver.yaml``."""

    max_command_age: Annotated[
        float, Field(gt=0.0, description="age of the sensors a command answers above which it is refused [s]")
    ]
    max_gap: Annotated[float, Field(gt=0.0, description="largest step of the joints' stamp believed at once [s]")]
    step_max: Annotated[
        float, Field(gt=0.0, description="step that the torque rate is counted over at most, after lost samples [s]")
    ]
    sensor_timeout: Annotated[float, Field(gt=0.0, description="silence of the joints after which it damps [s]")]


class MotorDriver:
    """``JointServo`` on the clock of the joint samples, with what its commanders may do.

    Each joint sample gives one vector of torques. A command is judged as the drivers of the simulation judge it: by the
    stamp of the sensors that it answers, its limits, and, where it is a trajectory, its start. No torque steps by more
    than the drives' rate times ``step_max``, whatever is commanded and however many samples were lost.

    A mode to move in that was there before the drivers does not arm them: motors must not come alive because a process
    was started.

    Args:
        model: The robot.
        config: Ages and steps.
        servo: Timing and margins of the servo; the packaged ones when None.
        counters: Counts gaps and commands that are too old.

    Attributes:
        servo: The law of the drivers.
    """

    def __init__(
        self, model: RobotModel, config: MotorDriverConfig, servo: JointServoConfig | None, counters: Counter[str]
    ) -> None:
        self.servo = JointServo(model, servo)
        self._config, self._counters = config, counters
        self._max_age = round(config.max_command_age * NANOSECONDS)
        self._max_gap = round(config.max_gap * NANOSECONDS)
        self._stamps = StampGuard(self._max_gap)
        self._mode: Mode | None = None
        self._last_command = 0

    def set_mode(self, mode: Mode) -> None:
        """Follow the supervisor: arm, damp or switch off.

        Raises:
            CommandError: Off, while the drivers are active. A mode to move in that was there before the drivers.
        """
        before, self._mode = self._mode, self._mode or mode
        if before is None and mode in ACTIVE_MODES:
            raise CommandError(f"mode '{mode.value}' was there before the drivers: 'damp' comes first")
        follow_mode(self.servo, before or Mode.OFF, mode)
        self._mode = mode

    def sample(self, stamp: int, q: Vector, v: Vector) -> Vector:
        """Answer joint positions (nj,) [rad] and velocities (nj,) [rad/s] of a stamp [ns] with torques (nj,) [N.m].

        Raises:
            MessageError: The stamp is not newer than the last one, or leaps ahead alone.
        """
        step = self._stamps.step(stamp)
        if step > self._max_gap:
            self._counters["gaps bridged"] += 1
        return self.servo.step(stamp / NANOSECONDS, q, v, min(step / NANOSECONDS, self._config.step_max))

    def command(self, stamp: int, command: JointCommand | JointTrajectory) -> bool:
        """Take a command that answers the sensors of a stamp [ns], 0 for now; returns whether it is in force.

        Raises:
            MessageError: The stamp is not newer than the last command's, not yet due, or too old.
            JointNameError: A joint of a trajectory is unknown or named twice.
            TrajectoryError: The trajectory is refused.
        """
        now = self._stamps.last
        if now is None:
            return False
        check_stamp(stamp, self._last_command, now, self._max_age, self._counters)
        t = now / NANOSECONDS
        if isinstance(command, JointTrajectory):
            taken = self.servo.command_trajectory(command, t)
        else:
            taken = self.servo.command(command, t)
        if taken:
            self._last_command = stamp or self._last_command
        return taken

    def silence(self) -> bool:
        """The joints have been silent for ``sensor_timeout``: damp; returns whether that is news."""
        if self.servo.state is not ServoState.ACTIVE:
            return False
        self._counters["joint silences"] += 1
        self.servo.damp()
        return True
