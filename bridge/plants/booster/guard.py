"""Guard of a Booster robot, which is assumed to keep the last command without a timeout."""

from collections.abc import Mapping
from typing import Any

from bridge.plants.booster.codec import MARK, BoosterCodec, read_config
from bridge.plants.booster.link import COMMAND
from bridge.plants.guard import SilenceGuard
from bridge.plants.hardware import RobotClock, real_robot, session
from bridge.plants.participant import CommandLink
from models.robot_model import RobotModel
from models.types import JointCommand


class BoosterGuard(SilenceGuard):
    """Watches the LowCmds of the driver (``MARK`` and its session) and replaces missing ones by damping commands.

    The driver's command with ``last``, at its end or when the vendor's controller is active, disarms the guard.
    """

    def __init__(self, model: RobotModel, options: Mapping[str, Any]) -> None:
        super().__init__(model)
        config = read_config(options)
        clock = RobotClock(1.0 / config.rate, real_robot().gap_max)
        self._codec = BoosterCodec(model, config, clock, session(), guard=True)
        self._data = b""  # the driver's last command

    def receive(self, data: bytes, now: float) -> None:
        """Handle a LowCmd received at a time [s]."""
        mark = self._codec.mark(data)
        if self._codec.is_foreign(data):
            self.foreign += 1
        elif mark[-1]:
            self._disarm()
        elif mark[0] == MARK:
            self._on_command(now)
            self._data = data

    def _last_command(self) -> JointCommand:
        return self._codec.decode_command(self._data)

    def _encode(self, command: JointCommand, now: float) -> bytes:
        return self._codec.encode(command)


def connect(model: RobotModel, domain: int, options: Mapping[str, Any]) -> tuple[BoosterGuard, CommandLink]:
    """Create the guard of a robot in a DDS domain and its connection; ``options`` are those of the plant."""
    return BoosterGuard(model, options), CommandLink(domain, "booster_interface", COMMAND)
