"""The loop of ``poise teleop``."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from std_msgs.msg import String

from bridge.ros.client import Client
from bridge.ros.operator import Operator
from bridge.teleop.config import TeleopConfig
from bridge.teleop.input import Gamepad, KeyLaw, keyboard, limits_of, read_keys
from controllers.commands.command_signature import Signer
from models.config import default_config
from models.nodes import topics
from models.nodes.odometry import Velocity
from models.nodes.qos import LATCHED
from models.nodes.spin import Stop
from models.robot_model import RobotModel
from planners.gait.config import load_gait_config

#: Actions other than words of the robot, and the word for the second: it also ends motions
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

    ``robot`` is the profile with the limits, by name or path, that of the graph when empty; with ``network`` it may run
    on another machine. ``gamepad`` is its device; None uses the keys of the terminal. ``signer`` None sends words
    unsigned; ``say`` takes lines for the terminal. Raises ``PoiseError`` when terminal, robot or gamepad is missing or
    disappears.
    """
    config = default_config(TeleopConfig, "bridge", "teleop")
    stop = Stop()
    with ExitStack() as stack:
        descriptor = -1 if gamepad is not None else stack.enter_context(keyboard(sys.stdin))
        client = stack.enter_context(Client(network=network, namespace=namespace))
        limits = limits_of(load_gait_config(RobotModel.load(robot or client.robot())).velocity)
        law, pad = KeyLaw(config, limits), None
        if gamepad is not None:
            pad = Gamepad(gamepad, config.gamepad, limits)
            stack.callback(pad.close)
        else:
            say("  ".join(f"{'space' if key == ' ' else key}: {meaning}" for key, meaning in config.keys.items()))
        operator = Operator(client, say, signer)
        stack.callback(operator.drive, None)  # in any case: zero, then silence
        commander = [""]
        client.subscribe(String, topics.COMMANDER, lambda message: commander.__setitem__(0, message.data), LATCHED)
        shown: tuple[object, ...] = ()
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
                _do(operator, deed)
            operator.drive(velocity if any(velocity) else None)
            if (client.mode, commander[0], velocity) != shown:
                shown = client.mode, commander[0], velocity
                say(_line(client.mode, commander[0], velocity))
            client.spin(1.0 / config.rate)


def _do(operator: Operator, deed: str) -> None:
    """Call the service of that name, otherwise publish a word."""
    if deed in operator.services:
        operator.call(deed)
    else:
        operator.say(STOP if deed == HALT else deed)


def _line(mode: str, commander: str, velocity: Velocity) -> str:
    """Status line for the operator."""
    forward, left, turn = velocity
    return (
        f"mode {mode or 'unknown'}, in command: {commander or 'unknown'}, "
        f"{forward:+.2f} m/s, {left:+.2f} m/s, {turn:+.2f} rad/s"
    )
