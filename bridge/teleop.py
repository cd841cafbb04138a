"""``poise teleop``: words and velocities from keyboard or gamepad."""

import os
import select
import struct
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from bridge.ros.client import Client
from bridge.ros.operator import Operator
from controllers.commands.command_signature import Signer
from models.config import STRICT, Positive, default_config
from models.errors import PoiseError
from models.nodes.spin import Stop
from models.robot_model import RobotModel
from models.types import Velocity
from planners.gait.config import Axis
from planners.gait.scaling import load_gait_config

Deed = Literal["halt", "walk", "stand", "wave", "E-STOP", "quit"]  #: Immediate action of a key or a button
Move = Literal["forward", "backward", "left", "right", "turn left", "turn right"]  #: Velocity change of a key


@dataclass(frozen=True, slots=True, config=STRICT)
class GamepadConfig:
    """Axes and buttons by the kernel's numbers; see ``bridge/config/teleop.yaml``."""

    axes: Annotated[dict[Axis, Annotated[int, Field(ge=0)]], Field(min_length=3)]
    deadband: Annotated[float, Field(ge=0.0, lt=1.0)]
    buttons: dict[int, Deed]


@dataclass(frozen=True, slots=True, config=STRICT)
class TeleopConfig:
    """Keys, steps and rates; see ``bridge/config/teleop.yaml``."""

    rate: Positive
    idle: Positive
    keys: dict[Annotated[str, Field(min_length=1, max_length=1)], Move | Deed]
    steps: Annotated[dict[Axis, Positive], Field(min_length=3)]
    gamepad: GamepadConfig


KEYS_MAX = 64  #: Keys that are read at a time [-]
SLACK = 1e-3  #: Rounding error accepted at a limit, as a fraction of a step [-]
#: Axis and sign of each move
_MOVES: Mapping[str, tuple[Axis, int]] = {
    "forward": ("forward", 1),
    "backward": ("forward", -1),
    "left": ("left", 1),
    "right": ("left", -1),
    "turn left": ("turn", 1),
    "turn right": ("turn", -1),
}


class KeyLaw:
    """Velocity command that keys change in steps, within the limits of the gait."""

    def __init__(self, config: TeleopConfig, limits: Mapping[Axis, tuple[float, float]]) -> None:
        self._config = config
        self._ranges = {axis: (*limits[axis], step) for axis, step in config.steps.items()}
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
        if not self._at_limit(axis, sign):
            self._steps[axis] += sign
        return ""

    def halt(self) -> None:
        """Set the velocity to zero."""
        self._steps = dict.fromkeys(self._steps, 0)

    def velocity(self, now: float) -> Velocity:
        """Forward [m/s], left [m/s], turn [rad/s] at a time [s]."""
        if now - self._pressed > self._config.idle:
            self.halt()
        size = {axis: min(max(self._steps[axis] * step, low), high) for axis, (low, high, step) in self._ranges.items()}
        return size["forward"], size["left"], size["turn"]

    def _at_limit(self, axis: Axis, sign: int) -> bool:
        """Whether the velocity is at its limit in a direction; the last step may be shorter than the others."""
        low, high, step = self._ranges[axis]
        value, slack = self._steps[axis] * step, SLACK * step
        return value >= high - slack if sign > 0 else value <= low + slack


@contextmanager
def keyboard(stream: IO[str] = sys.stdin) -> Iterator[int]:
    """Disable echo and line buffering of a terminal; yields its descriptor. ``PoiseError`` for any other stream."""
    if not stream.isatty():
        raise PoiseError(
            "poise teleop needs a terminal for its keys, and the standard input is none; --gamepad works without one"
        )
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
        raise PoiseError(f"the terminal was closed: {error.strerror}") from error


EVENT = struct.Struct("<IhBB")  #: ``struct js_event``: time [ms], value, type, number (linux/joystick.h)
BUTTON, AXIS, INITIAL = 0x01, 0x02, 0x80  #: Event types; ``INITIAL`` is a flag of events that report the initial state
FULL = 32767.0  #: Value of a full deflection [-]


class Gamepad:
    """Reads a joystick device, such as ``/dev/input/js0``, without blocking.

    The deflection of a stick scales the velocity limit; forward and left are positive (REP-103). A stick that is
    deflected at the start is ignored until it is released. Raises ``PoiseError`` when the device cannot be opened.
    """

    def __init__(self, device: Path, config: GamepadConfig, limits: Mapping[Axis, tuple[float, float]]) -> None:
        self._device, self._config, self._limits = device, config, limits
        try:
            self._file = os.open(device, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise PoiseError(f"{device}: cannot be opened as a gamepad: {error.strerror}") from error
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
        deflection = -self._deflection.get(number, 0.0)  # backward and right are positive on gamepads
        if number not in self._centred or abs(deflection) < self._config.deadband:
            return 0.0
        low, high = self._limits[axis]
        return deflection * (high if deflection > 0.0 else -low)

    def _bytes(self) -> bytes:
        try:
            if read := os.read(self._file, 64 * EVENT.size):
                return read
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PoiseError(f"{self._device}: the gamepad was disconnected: {error.strerror}") from error
        raise PoiseError(f"{self._device}: end of file: not a gamepad, or disconnected; try /dev/input/js0")


#: Actions that are no text commands, and the command that ``HALT`` sends: it also ends motions
QUIT, HALT, STOP = "quit", "halt", "stop"


def teleop(
    robot: str,
    *,
    gamepad: Path | None = None,
    network: bool = False,
    namespace: str = "",
    signer: Signer | None = None,
    say: Callable[[str], object] = print,
) -> None:
    """Steer the running robot as ``teleop`` until Ctrl-C or the key that quits.

    ``robot`` is the profile with the limits, by name or path; when empty, the profile of the graph. With ``network``
    the robot may run on another machine. ``gamepad`` is a device; None uses the keys of the terminal. Text commands are
    unsigned when ``signer`` is None; ``say`` prints a line on the terminal. Raises ``PoiseError`` when terminal, robot
    or gamepad is missing or disappears.
    """
    config = default_config(TeleopConfig, "bridge", "teleop")
    stop = Stop()
    with ExitStack() as stack:
        descriptor = -1 if gamepad is not None else stack.enter_context(keyboard(sys.stdin))
        client = stack.enter_context(Client(network=network, namespace=namespace))
        limits = load_gait_config(RobotModel.load(robot or client.robot())).velocity.ranges
        law, pad = KeyLaw(config, limits), None
        if gamepad is not None:
            pad = Gamepad(gamepad, config.gamepad, limits)
            stack.callback(pad.close)
        else:
            say("  ".join(f"{'space' if key == ' ' else key}: {meaning}" for key, meaning in config.keys.items()))
        operator = Operator(client, say, signer)
        stack.callback(operator.leave)  # on every exit: replaces a commanded velocity by zero
        shown: tuple[str, str, Velocity] | None = None
        while not stop.requested:
            now = time.monotonic()
            if pad is not None:
                deeds, velocity = pad.read(), pad.velocity()
            else:
                deeds = [deed for key in read_keys(descriptor) if (deed := law.press(key, now))]
                velocity = law.velocity(now)
            for deed in deeds:
                if deed == QUIT:
                    return
                if deed in operator.services:
                    operator.call(deed)
                else:
                    operator.say(STOP if deed == HALT else deed)
            operator.drive(velocity if any(velocity) else None)
            if (client.mode, client.commander, velocity) != shown:
                shown = client.mode, client.commander, velocity
                say(_line(*shown))
            client.spin(1.0 / config.rate)


def _line(mode: str, commander: str, velocity: Velocity) -> str:
    forward, left, turn = velocity
    return (
        f"mode {mode or 'unknown'}, in command: {commander or 'unknown'}, "
        f"{forward:+.2f} m/s, {left:+.2f} m/s, {turn:+.2f} rad/s"
    )
