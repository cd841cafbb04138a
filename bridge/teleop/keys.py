"""Keys to a velocity, which goes back to zero when nobody presses any more."""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import IO

from bridge.teleop.config import Axis, TeleopConfig
from models.errors import PoiseError
from models.nodes.velocity import Velocity
from planners.gait.config import VelocityConfig

KEYS_MAX = 64
"""Keys that are read at a time [-]."""

SLACK = 1e-3
"""Rounding that is let pass at a limit, in parts of a step [-]."""

_MOVES: Mapping[str, tuple[Axis, int]] = {
    "forward": ("forward", 1),
    "backward": ("forward", -1),
    "left": ("left", 1),
    "right": ("left", -1),
    "turn left": ("turn", 1),
    "turn right": ("turn", -1),
}
"""Axis and sign of each move."""


def limits_of(config: VelocityConfig) -> dict[Axis, tuple[float, float]]:
    """Least and greatest velocity of each axis [m/s], [m/s], [rad/s]."""
    return {
        "forward": (-config.backward, config.forward),
        "left": (-config.lateral, config.lateral),
        "turn": (-config.turn, config.turn),
    }


class KeyLaw:
    """A velocity that keys change by steps, within the limits of the gait.

    Args:
        config: Keys and steps.
        limits: Least and greatest velocity of each axis.
    """

    def __init__(self, config: TeleopConfig, limits: Mapping[Axis, tuple[float, float]]) -> None:
        self._config, self._limits = config, limits
        self._steps: dict[Axis, int] = dict.fromkeys(config.steps, 0)
        self._pressed = 0.0

    def press(self, key: str, now: float) -> str:
        """Take a key at a time [s].

        Returns:
            What is to be done at once; empty when the key only changed the velocity, or means nothing.
        """
        self.velocity(now)  # whose time is up does not come back with this key
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
        """Back to zero."""
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
    """Terminal that gives every key at once and shows none, until it ends.

    Yields:
        Its file descriptor, for ``read_keys``.

    Raises:
        PoiseError: The stream is no terminal.
    """
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
    """Keys that were pressed since the last time.

    Raises:
        PoiseError: The terminal is gone.
    """
    try:
        ready, _, _ = select.select([descriptor], [], [], 0.0)
        return os.read(descriptor, KEYS_MAX).decode(errors="ignore") if ready else ""
    except OSError as error:
        raise PoiseError(f"the terminal is gone: {error.strerror}") from error
