"""Guard of a robot behind ros2_control: its command controllers keep the last command, without a time-out."""

import numpy as np

from bridge.plants.guard import SILENCE, SilenceGuard
from bridge.plants.ros2_control.commands import DRIVER, GUARD, CommandCodec
from bridge.plants.ros2_control.config import JOINTS
from bridge.plants.ros2_control.link import Message
from bridge.plants.ros2_control.sensors import JointStateDecoder
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import JointCommand


class ControlGuard(SilenceGuard):
    """Watches the commands of the driver and the joint states, and makes damping commands while there are none.

    A controller of torques gets -kd v of the newest joint state, and no torque while there is none and at the end.
    """

    def __init__(self, model: RobotModel, codec: CommandCodec) -> None:
        super().__init__()
        self._joints, self._codec = JointStateDecoder(model), codec
        zero = np.zeros(model.nj)
        self._damping, self._limp = JointCommand(zero, zero, zero, zero, model.kd), JointCommand.torque(zero)
        self._stamp, self._q, self._v = 0, zero, zero
        self._measured = -np.inf  # time of the newest joint state [s]

    def receive(self, message: Message, now: float) -> None:
        """A command or joint state from the network at a time [s]."""
        source, data = message
        if source == JOINTS:
            try:
                self._stamp, self._q, self._v, _ = self._joints.decode(data)
                self._measured = now
            except PoiseError:
                self.refused += 1
            return
        mark = self._codec.mark(data)
        if mark == DRIVER:
            self._last = now
        elif mark != GUARD:
            self.strangers += 1

    def final_command(self) -> bytes | None:
        return self._encode(self._limp) if self._codec.evaluated else None

    def _damping_command(self, now: float) -> bytes:
        measured = not self._codec.evaluated or now - self._measured < SILENCE
        return self._encode(self._damping if measured else self._limp)

    def _encode(self, command: JointCommand) -> bytes:
        return self._codec.encode(self._stamp, command, self._q, self._v)
