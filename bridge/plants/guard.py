"""Guard of a real robot: damps it when its driver is silent, because the robot keeps its last command."""

from typing import Any

import numpy as np

from bridge.plants.hardware import real_robot
from controllers.joints.joint_servo import fade_to_damping
from models.robot_model import RobotModel
from models.types import JointCommand


class SilenceGuard:
    """Measures the silence of the driver; a guard of one protocol receives its commands and makes damping ones.

    The torque of the last command fades into damping, as the driver's own would. The guard has no effect before the
    first command of the driver with the same ``session``; others are foreign. ``active``
    is whether the guard commands, ``interventions`` counts how often it began to.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        config = real_robot()
        self._silence_max, self._beat_period = config.silence_max, config.beat_period
        self._beat_at = -np.inf  # when the next heartbeat is due [s]
        self._last = -np.inf  # time of the driver's last command [s]
        self._command: JointCommand | None = None  # the driver's last one, while the guard commands
        self._since = 0.0  # when the guard began to command [s]
        self.active = False
        self.interventions = 0
        self.refused = 0  #: Messages that cannot be used
        self.foreign = 0  #: Commands of neither the driver nor the guard of this graph

    @property
    def armed(self) -> bool:
        """Whether the driver has commanded the robot."""
        return bool(self._last > -np.inf)

    def silence(self, now: float) -> float:
        """Time since the driver's last command at a time [s]."""
        return now - self._last

    def beat_due(self, now: float) -> bool:
        """Whether a heartbeat is due at a time [s]; the next one is, a period later."""
        if now < self._beat_at:
            return False
        self._beat_at = now + self._beat_period
        return True

    def receive(self, message: Any, now: float) -> None:
        """A message of the protocol, at a time [s]."""
        raise NotImplementedError

    def step(self, now: float) -> bytes | None:
        """The command to publish at a time [s]; None while the driver commands, or has not begun."""
        self.active = self.armed and self.silence(now) > self._silence_max
        if not self.active:
            return None
        if self._command is None:
            self.interventions += 1
            self._since, self._command = now, self._last_command()
        return self._encode(fade_to_damping(self._model, self._command, now - self._since), now)

    def final_command(self) -> bytes | None:
        """The command that is left in force when the guard ends; None for the last damping one."""
        return None

    def _on_command(self, now: float) -> None:
        """The driver has commanded at a time [s]."""
        self._last, self._command = now, None

    def _disarm(self) -> None:
        """The driver commands no longer, by intention."""
        self._last, self._command = -np.inf, None

    def _last_command(self) -> JointCommand:
        """Command of the driver's last message."""
        raise NotImplementedError

    def _encode(self, command: JointCommand, now: float) -> bytes:
        """Serialised message of a command of the guard at a time [s]."""
        raise NotImplementedError
