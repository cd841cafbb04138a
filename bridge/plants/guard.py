"""Watchdog of a real robot: damps it when its driver is silent, because the robot keeps its last command."""

from typing import Any

import numpy as np

from bridge.plants.hardware import real_robot
from controllers.joints.joint_servo import fade_to_damping
from models.robot_model import RobotModel
from models.types import JointCommand


class SilenceGuard:
    """Watchdog of the driver's commands. Subclasses decode and encode the messages of one protocol.

    When the driver is silent, the torque of its last command fades into damping, as at the end of the driver. The guard
    has no effect before the first command of the driver with the same ``session``; other commands are foreign.
    ``active`` is whether the guard commands the robot, ``interventions`` counts how often it began to. ``speed`` is
    that of ``HardwarePlant``.
    """

    def __init__(self, model: RobotModel, speed: float = 1.0) -> None:
        self._model = model
        config = real_robot()
        self._silence_max, self._beat_period = config.silence_max / speed, config.beat_period
        self._beat_at = -np.inf  # time of the next heartbeat [s]
        self._last = -np.inf  # time of the driver's last command [s]
        self._command: JointCommand | None = None  # last command of the driver, while the guard commands
        self._since = 0.0  # time at which the guard began to command [s]
        self.active = False
        self.interventions = 0
        self.refused = 0  #: Messages that could not be decoded
        self.foreign = 0  #: Commands of other programs than the driver and the guard of this graph

    @property
    def armed(self) -> bool:
        """Whether the driver has commanded the robot and not disarmed the guard since."""
        return bool(self._last > -np.inf)

    def silence(self, now: float) -> float:
        """Time since the driver's last command [s], at a time [s]."""
        return now - self._last

    def beat_due(self, now: float) -> bool:
        """Whether a heartbeat is due at a time [s]; if so, the next one is due a period later."""
        if now < self._beat_at:
            return False
        self._beat_at = now + self._beat_period
        return True

    def receive(self, message: Any, now: float) -> None:
        """Handle a message of the protocol received at a time [s]."""
        raise NotImplementedError

    def step(self, now: float) -> bytes | None:
        """The command to publish at a time [s]; None while the driver commands, and before its first command."""
        self.active = self.armed and self.silence(now) > self._silence_max
        if not self.active:
            return None
        if self._command is None:
            self.interventions += 1
            self._since, self._command = now, self._last_command()
        return self._encode(fade_to_damping(self._model, self._command, now - self._since), now)

    def final_command(self) -> bytes | None:
        """The command to leave in force when the guard ends; None to keep the last damping command."""
        return None

    def _on_command(self, now: float) -> None:
        """Record a command of the driver at a time [s]."""
        self._last, self._command = now, None

    def _disarm(self) -> None:
        """Record that the driver has ended its commands intentionally."""
        self._last, self._command = -np.inf, None

    def _last_command(self) -> JointCommand:
        """Command in the driver's last message."""
        raise NotImplementedError

    def _encode(self, command: JointCommand, now: float) -> bytes:
        """Serialised message of a command of the guard at a time [s]."""
        raise NotImplementedError
