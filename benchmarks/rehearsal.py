"""``poise rehearse``: simulated G1 on a gantry behind Unitree's protocol, to practise the start of a real robot."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from benchmarks.cli import report_errors

if TYPE_CHECKING:
    from benchmarks.graph.robot_process import RobotProcess

app = typer.Typer()
PRESS_TIME = 0.5  #: Time for which a button is pressed [s]
ROPE_SPEED = 0.05  #: Speed at which the rope is let out [m/s]
PUSH = 12.0, 0.1  #: Impulse of a push to the left [N.s] and its duration [s]
HOT = 91.0  #: Temperature of all motors when hot [degree Celsius]
COLD = 35.0  #: Temperature of all motors when not hot [degree Celsius]
LOW, FULL = 41.0, 50.0  #: Voltage of an empty and of a full battery [V]
HELP = """\
  press   press and release button B of the remote controller
  lower   let out the rope at 5 cm/s         free   unhook the rope
  raise   hook the rope and wind it up       push   12 N.s to the left
  hot, cold   motors at 91 or 35 degC        empty, full   battery at 41 or 50 V
  other, alone   start, stop commands of another program
  type4, type5   set mode_machine
  cut, plug   disconnect, connect the cable  show   the true state      end"""


def press(robot: RobotProcess) -> None:
    """Press and release the stop button."""
    from bridge.plants.unitree.codec import BUTTONS

    robot("press", BUTTONS.index("B"))
    time.sleep(PRESS_TIME)
    robot("press")


def state(robot: RobotProcess) -> str:
    """Return the true state of the robot in one line."""
    seen = robot("report")
    x, y, z = seen["base"]
    return (
        f"base at ({x:.2f}, {y:.2f}, {z:.2f}) m, load on the feet {seen['load']:.0f} N, largest gains "
        f"kp {seen['kp']:g} kd {seen['kd']:g}, {seen['received']} commands received, {seen['refused']} refused"
    )


ACTS: dict[str, Callable[[RobotProcess], object]] = {
    "press": press,
    "lower": lambda robot: robot("set", "rope_speed", ROPE_SPEED),
    "raise": lambda robot: (robot("tie"), robot("set", "rope_speed", -ROPE_SPEED)),
    "free": lambda robot: robot("set", "hooked", False),
    "push": lambda robot: robot("push", 0.0, PUSH[0] / PUSH[1], 0.0, PUSH[1]),
    "hot": lambda robot: robot("fill", "temperature", HOT),
    "cold": lambda robot: robot("fill", "temperature", COLD),
    "empty": lambda robot: robot("fill", "voltage", LOW),
    "full": lambda robot: robot("fill", "voltage", FULL),
    "other": lambda robot: robot("other", True),
    "alone": lambda robot: robot("other", False),
    "type4": lambda robot: robot("set", "mode_machine", 4),
    "type5": lambda robot: robot("set", "mode_machine", 5),
    "cut": lambda robot: robot("connect", False),
    "plug": lambda robot: robot("connect", True),
    "show": state,
}


def act(robot: RobotProcess, word: str) -> str:
    """Perform the act of a word and return the text to print."""
    if word not in ACTS:
        return f"unknown command '{word}'; known:\n{HELP}"
    done = ACTS[word](robot)
    return done if isinstance(done, str) else state(robot)


@app.command()
def rehearse(
    domain: Annotated[int, typer.Option(min=1, help="DDS domain of the simulated robot; a real robot uses 0.")] = 78,
    robot: Annotated[str, typer.Option(help="Profile of the simulated robot.")] = "g1",
    speed: Annotated[
        float, typer.Option(min=0.1, help="Ratio of simulated to real time; smaller on a slow machine.")
    ] = 1.0,
) -> None:
    """Hang a simulated G1 from its gantry behind Unitree's protocol on loopback, to practise docs/real_robot.md."""
    from benchmarks.graph.robot_process import RobotProcess
    from models.profile import load_profile

    console = Console()
    with tempfile.TemporaryDirectory() as folder, report_errors(console):
        load_profile(robot)  # report errors before the process starts
        slow = f' --plant-options "{{speed: {speed:g}}}"' if speed < 1.0 else ""
        process = RobotProcess("ros", "lo", Path(folder), robot, 500, speed, domain=domain)
        try:
            console.print(
                f"{state(process)}\nin another terminal:\n"
                f"  poise up --robot g1 --plant unitree --network-interface lo --robot-domain {domain}{slow}\n"
                f"then follow poise status there; commands here:\n{HELP}",
                markup=False, highlight=False, soft_wrap=True,
            )  # fmt: skip
            while (word := console.input("> ").strip().lower()) != "end":
                if word:
                    console.print(act(process, word), markup=False, highlight=False, soft_wrap=True)
        except (EOFError, KeyboardInterrupt):
            pass
        finally:
            process.close()
