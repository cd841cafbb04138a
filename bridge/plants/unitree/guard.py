"""Guard of a Unitree robot, which keeps the last command without a timeout."""

from collections.abc import Mapping
from typing import Any

from bridge.plants.guard import SilenceGuard
from bridge.plants.hardware import session
from bridge.plants.participant import CommandLink
from bridge.plants.unitree.codec import GUARD_MARK, MARK, is_foreign, joint_command, read_times, set_command
from bridge.plants.unitree.link import COMMAND
from bridge.plants.unitree.wire import LOW_CMD
from models.errors import MessageError
from models.robot_model import RobotModel
from models.types import JointCommand


class DampingGuard(SilenceGuard):
    """Watches the LowCmds of the driver (``MARK`` and its session) and replaces missing ones by damping commands.

    The driver sends its first command after the release of the vendor's controller. Its command with ``last``, at its
    end or when the vendor's controller becomes active again, disarms the guard.
    """

    def __init__(self, model: RobotModel, speed: float = 1.0) -> None:
        super().__init__(model, speed)
        self._record: Any = None  # record of the newest command of driver or guard

    def receive(self, data: bytes, now: float) -> None:
        """Handle a LowCmd received at a time [s]."""
        try:
            record = LOW_CMD.read(data)
        except MessageError:
            self.refused += 1
            return
        if is_foreign(data, session()):
            self.foreign += 1
        elif record["reserve"][3]:
            self._disarm()
        elif record["reserve"][0] == MARK:
            self._on_command(now)
            self._record = record

    def _last_command(self) -> JointCommand:
        return joint_command(self._record, self._model.nj)

    def _encode(self, command: JointCommand, now: float) -> bytes:
        model, record = self._model, self._record
        record["reserve"][0] = GUARD_MARK
        set_command(record["motor_cmd"][: model.nj], command, model.kp, model.kd)
        return LOW_CMD.write(record)


def connect(model: RobotModel, domain: int, options: Mapping[str, Any]) -> tuple[DampingGuard, CommandLink]:
    """Create the guard of a robot in a DDS domain and its connection; ``options`` are those of the plant."""
    _, speed = read_times(options)
    return DampingGuard(model, speed), CommandLink(domain, "unitree_hg", COMMAND)
