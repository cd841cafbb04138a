"""A gamepad through the kernel's joystick interface: sticks to a velocity, buttons to deeds."""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from pathlib import Path

from bridge.teleop.config import Axis, GamepadConfig
from models.errors import PoiseError
from models.nodes.velocity import Velocity

EVENT = struct.Struct("<IhBB")
"""``struct js_event``: time [ms], value, type, number (linux/joystick.h)."""

BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80
"""Types of events; the last is added to those that tell the state at the beginning."""

FULL = 32767.0
"""Value of a full deflection [-]."""


class Gamepad:
    """Reads a joystick device without waiting for it.

    Sticks give parts of the limits: pushed away and to the left is positive, as REP-103 counts. One that is found
    deflected counts once it has been let go.

    Args:
        device: Such as ``/dev/input/js0``.
        config: Numbers of axes and buttons.
        limits: Least and greatest velocity of each axis.

    Raises:
        PoiseError: The device cannot be opened.
    """

    def __init__(self, device: Path, config: GamepadConfig, limits: Mapping[Axis, tuple[float, float]]) -> None:
        self._device, self._config, self._limits = device, config, limits
        try:
            self._file = os.open(device, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise PoiseError(f"{device}: no gamepad there: {error.strerror}") from error
        self._deflection: dict[int, float] = {}
        self._centred: set[int] = set()
        self._rest = b""

    def read(self) -> list[str]:
        """Take what has happened since the last time.

        Returns:
            What is to be done at once, in order.

        Raises:
            PoiseError: The gamepad is gone.
        """
        deeds: list[str] = []
        self._rest += self._bytes()
        whole = len(self._rest) - len(self._rest) % EVENT.size
        for _, value, kind, number in EVENT.iter_unpack(self._rest[:whole]):
            if kind & ~INITIAL == AXIS:
                self._deflection[number] = deflection = max(value / FULL, -1.0)
                if abs(deflection) < self._config.deadband:
                    self._centred.add(number)
            elif kind == BUTTON and value and number in self._config.buttons:
                deeds.append(self._config.buttons[number])
        self._rest = self._rest[whole:]
        return deeds

    def velocity(self) -> Velocity:
        """Forward [m/s], left [m/s], turn [rad/s]."""
        return self._along("forward"), self._along("left"), self._along("turn")

    def close(self) -> None:
        """Let go of the device."""
        os.close(self._file)

    def _along(self, axis: Axis) -> float:
        number = self._config.axes[axis]
        deflection = -self._deflection.get(number, 0.0)  # pads count down and right as positive
        if number not in self._centred or abs(deflection) < self._config.deadband:
            return 0.0
        low, high = self._limits[axis]
        return deflection * (high if deflection > 0.0 else -low)

    def _bytes(self) -> bytes:
        try:
            return os.read(self._file, 64 * EVENT.size)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PoiseError(f"{self._device}: the gamepad is gone: {error.strerror}") from error
