"""Guard of a Unitree robot: damps it when its driver is silent, because the robot keeps the last command for ever."""

from typing import Any

import numpy as np

from bridge.plants.unitree.codec import GUARD_MARK, MARK, joint_command, set_command
from bridge.plants.unitree.wire import read_low_cmd, write_low_cmd
from controllers.joints.joint_servo import fade_to_damping
from models.errors import MessageError
from models.robot_model import RobotModel
from models.types import JointCommand

SILENCE = 0.02  #: Time without a command of the driver after which the guard damps [s]


class DampingGuard:
    """Watches the LowCmds of the driver, which carry ``MARK``, and makes damping ones while there are none.

    The torque of the last command fades into damping, as the driver's own would. It has no effect before the driver's
    first command, which is what releases the robot's own controller. ``active`` is whether the guard commands,
    ``interventions`` counts how often it began to. The driver's ``last`` command, for the robot's own controller that
    has become active, ends that.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._last = -np.inf  # time of the driver's last command [s]
        self._record: Any = None  # of the driver's last command
        self._command: JointCommand | None = None  # the same, while the guard commands
        self._since = 0.0  # when the guard began to command [s]
        self.active = False
        self.interventions = 0
        self.refused = 0  #: Commands with a wrong size or checksum
        self.strangers = 0  #: Commands of neither the driver nor a guard

    @property
    def armed(self) -> bool:
        """Whether the driver has commanded the robot."""
        return self._record is not None

    def silence(self, now: float) -> float:
        """Time since the driver's last command at a time [s]."""
        return now - self._last

    def receive(self, data: bytes, now: float) -> None:
        """A LowCmd from the network at a time [s]."""
        try:
            record = read_low_cmd(data)
        except MessageError:
            self.refused += 1
            return
        if record["reserve"][0] != MARK:
            self.strangers += int(record["reserve"][0] != GUARD_MARK)
            return
        self._last, self._record, self._command = now, None if record["reserve"][3] else record, None

    def step(self, now: float) -> bytes | None:
        """The command to publish at a time [s]; None while the driver commands, or has not begun."""
        self.active = self.armed and now - self._last > SILENCE
        if not self.active:
            return None
        model, record = self._model, self._record
        if self._command is None:
            self.interventions += 1
            self._since, self._command = now, joint_command(record, model.nj)
            record["reserve"][0] = GUARD_MARK
        command = fade_to_damping(model, self._command, now - self._since)
        set_command(record["motor_cmd"][: model.nj], command, model.kp, model.kd)
        return write_low_cmd(record)
