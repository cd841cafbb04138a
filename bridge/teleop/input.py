"""Input of the terminal and of a gamepad as steering commands."""

from __future__ import annotations

import os
import select
import struct
import sys
import termios
import tty
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from bridge.teleop.config import Axis, GamepadConfig, TeleopConfig
from models.errors import PoiseError
from models.nodes.odometry import Velocity
from planners.gait.config import VelocityConfig

KEYS_MAX = 64  #: Keys that are read at a time [-]
SLACK = 1e-3  #: Rounding accepted at a limit, in parts of a step [-]
#: Axis and sign of each move
_MOVES: Mapping[str, tuple[Axis, int]] = {
    "forward": ("forward", 1),
    "backward": ("forward", -1),
    "left": ("left", 1),
    "right": ("left", -1),
    "turn left": ("turn", 1),
    "turn right": ("turn", -1),
}


def limits_of(config: VelocityConfig) -> dict[Axis, tuple[float, float]]:
    """Least and greatest velocity of each axis [m/s], [m/s], [rad/s]."""
    return {
        "forward": (-config.backward, config.forward),
        "left": (-config.lateral, config.lateral),
        "turn": (-config.turn, config.turn),
    }


class KeyLaw:
    """A velocity that keys change by steps, within the limits of the gait."""

    def __init__(self, config: TeleopConfig, limits: Mapping[Axis, tuple[float, float]]) -> None:
        self._config, self._limits = config, limits
        self._steps: dict[Axis, int] = dict.fromkeys(config.steps, 0)
        self._pressed = 0.0

    def press(self, key: str, now: float) -> str:
        """Process a key at a time [s]; returns an action to execute at once, or empty."""
        self.velocity(now)  # an expired velocity is not restored by this key
        self._pressed = now
        meaning = self._config.keys.get(key, "")
        if meaning not in _MOVES:
            if meaning:
                self.halt()
            return meaning
        axis, sign = _MOVES[meaning]
        if self._within(axis, self._steps[axis] + sign):
            self._steps[axis] += sign
        return ""

    def halt(self) -> None:
        """Set the velocity to zero."""
        self._steps = dict.fromkeys(self._steps, 0)

    def velocity(self, now: float) -> Velocity:
        """Forward [m/s], left [m/s], turn [rad/s] at a time [s]."""
        if now - self._pressed > self._config.idle:
            self.halt()
        size = {axis: self._steps[axis] * step for axis, step in self._config.steps.items()}
        return size["forward"], size["left"], size["turn"]

    def _within(self, axis: Axis, steps: int) -> bool:
        low, high = self._limits[axis]
        slack = SLACK * self._config.steps[axis]
        return low - slack <= steps * self._config.steps[axis] <= high + slack


@contextmanager
def keyboard(stream: IO[str] = sys.stdin) -> Iterator[int]:
    """Terminal without echo and line buffer; yields its descriptor. ``PoiseError`` if ``stream`` is no terminal."""
    if not stream.isatty():
        raise PoiseError("poise teleop reads keys from a terminal, and this is none; --gamepad needs none")
    descriptor = stream.fileno()
    before = termios.tcgetattr(descriptor)
    try:
        tty.setcbreak(descriptor)
        yield descriptor
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def read_keys(descriptor: int) -> str:
    """Keys pressed since the last call; ``PoiseError`` when the terminal is closed."""
    try:
        ready, _, _ = select.select([descriptor], [], [], 0.0)
        return os.read(descriptor, KEYS_MAX).decode(errors="ignore") if ready else ""
    except OSError as error:
        raise PoiseError(f"the terminal is gone: {error.strerror}") from error


EVENT = struct.Struct("<IhBB")  #: ``struct js_event``: time [ms], value, type, number (linux/joystick.h)
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80  #: Types of events; the last is added to those of the initial state
FULL = 32767.0  #: Value of a full deflection [-]


class Gamepad:
    """Reads a joystick device, such as ``/dev/input/js0``, without blocking.

    Sticks give parts of the limits: forward and left are positive (REP-103). A stick that is deflected at the start
    counts once it has been released. Raises ``PoiseError`` when the device cannot be opened.
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
        """Read new events; returns the actions to execute, in order. ``PoiseError`` when it is disconnected."""
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
        """Close the device."""
        os.close(self._file)

    def _along(self, axis: Axis) -> float:
        number = self._config.axes[axis]
        deflection = -self._deflection.get(number, 0.0)  # pads count backward and right as positive
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
