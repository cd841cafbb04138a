"""Guard of a Unitree robot: damps it when its driver is silent, because the robot keeps the last command for ever."""

import numpy as np

from bridge.plants.unitree.codec import GUARD_MARK, MARK
from bridge.plants.unitree.wire import read_low_cmd, write_low_cmd
from models.errors import MessageError
from models.types import Vector

SILENCE = 0.02  #: Time without a command of the driver after which the guard damps [s]


class DampingGuard:
    """Watches the LowCmds of the driver, which carry ``MARK``, and makes damping ones while there are none.

    It has no effect before the driver's first command, which is what releases the robot's own controller. ``damping``
    (nj,) are the gains [N.m.s/rad]. ``active`` is whether the guard commands, ``interventions`` counts how often it
    began to.
    """

    def __init__(self, damping: Vector) -> None:
        self._damping = damping
        self._last = -np.inf  # time of the driver's last command [s]
        self._command: bytes | None = None
        self.active = False
        self.interventions = 0
        self.refused = 0  #: Commands with a wrong size or checksum
        self.strangers = 0  #: Commands of neither the driver nor a guard

    @property
    def armed(self) -> bool:
        """Whether the driver has commanded the robot."""
        return self._command is not None

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
        self._last = now
        if self._command is None or self.active:
            motors = record["motor_cmd"]
            for name in ("q", "dq", "tau", "kp", "kd"):
                motors[name] = 0.0
            motors["kd"][: len(self._damping)] = self._damping
            record["reserve"][0] = GUARD_MARK
            self._command = write_low_cmd(record)

    def step(self, now: float) -> bytes | None:
        """The command to publish at a time [s]; None while the driver commands, or has not begun."""
        silent = self._command is not None and now - self._last > SILENCE
        if silent and not self.active:
            self.interventions += 1
        self.active = silent
        return self._command if silent else None
