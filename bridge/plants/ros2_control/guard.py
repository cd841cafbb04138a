"""Guard of a robot behind ros2_control, whose command controllers keep the last command without a timeout."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from bridge.plants.guard import SilenceGuard
from bridge.plants.ros2_control.commands import GUARD, CommandCodec, command_codec, driver_mark
from bridge.plants.ros2_control.config import COMMAND, JOINTS, read_config
from bridge.plants.ros2_control.link import Message, RosLink
from bridge.plants.ros2_control.sensors import JointStateDecoder
from controllers.joints.joint_servo import damping_command
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import JointCommand


class ControlGuard(SilenceGuard):
    """Watches the driver's commands and the joint states, and replaces missing commands by damping commands.

    An effort controller gets -kd v of the newest joint state in addition to the fading last torque. Without a recent
    joint state it gets only the fading torque. At the end it gets zero torque.
    """

    def __init__(self, model: RobotModel, codec: CommandCodec) -> None:
        super().__init__(model)
        self._joints, self._codec = JointStateDecoder(model), codec
        self._data, self._driver = b"", driver_mark()  # last command of driver or guard; mark of the driver
        zero = np.zeros(model.nj)
        self._stamp, self._q, self._v = 0, zero, zero
        self._measured = -np.inf  # time of the newest joint state [s]

    def receive(self, message: Message, now: float) -> None:
        """Handle a command or joint state received at a time [s]."""
        source, data = message
        if source == JOINTS:
            try:
                self._stamp, self._q, self._v, _ = self._joints.decode(data)
                self._measured = now
            except PoiseError:
                self.refused += 1
            return
        mark = self._codec.mark(data)
        if mark == self._driver:
            self._on_command(now)
            self._data = data
        elif mark != GUARD:
            self.foreign += 1

    def final_command(self) -> bytes | None:
        if not self._codec.evaluated:
            return None
        return self._codec.encode(self._stamp, JointCommand.torque(np.zeros(self._model.nj)), self._q, self._v)

    def _last_command(self) -> JointCommand:
        try:
            return self._codec.decode(self._data)
        except PoiseError:
            self.refused += 1
            self._data = b""
            return damping_command(self._model)

    def _encode(self, command: JointCommand, now: float) -> bytes:
        if self._codec.evaluated and not now - self._measured < self._silence_max:
            command = JointCommand.torque(command.tau)
        self._data = self._codec.encode(self._stamp, command, self._q, self._v, self._data)
        return self._data


def connect(model: RobotModel, domain: int, options: Mapping[str, Any]) -> tuple[ControlGuard, RosLink]:
    """Create the guard of a robot in a DDS domain and its connection; ``options`` are those of the plant."""
    config = read_config({**options, "controller_manager": ""})
    codec = command_codec(model, config, GUARD)
    return ControlGuard(model, codec), RosLink(domain, config, (JOINTS, COMMAND), codec.kind)
