"""Guard of a Unitree robot, which keeps the last command for ever."""

from bridge.plants.guard import SilenceGuard
from bridge.plants.unitree.codec import GUARD_MARK, MARK
from bridge.plants.unitree.wire import read_low_cmd, write_low_cmd
from models.errors import MessageError
from models.types import Vector


class DampingGuard(SilenceGuard):
    """Watches the LowCmds of the driver, which carry ``MARK``, and makes damping ones while there are none.

    The driver's first command is what releases the robot's own controller. ``damping`` (nj,) are the gains
    [N.m.s/rad].
    """

    def __init__(self, damping: Vector) -> None:
        super().__init__()
        self._damping = damping
        self._command = b""

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
        if not self.armed or self.active:
            motors = record["motor_cmd"]
            for name in ("q", "dq", "tau", "kp", "kd"):
                motors[name] = 0.0
            motors["kd"][: len(self._damping)] = self._damping
            record["reserve"][0] = GUARD_MARK
            self._command = write_low_cmd(record)
        self._last = now

    def _damping_command(self, now: float) -> bytes:
        return self._command
