"""Commands to a running robot: texts, modes, walks, reaching, calibrations and the crane."""

import re
import select
import sys
from pathlib import Path
from typing import Annotated

import typer

from bridge.commands.common import Namespace, Network, connected, print_reply, say
from models.errors import PoiseError
from models.nodes import topics

MODE_SERVICES = {
    **{word: f"mode/{word}" for word in ("off", "damp", "stand", "walk")},
    **{word: word for word in ("estop", "reset_faults")},
}  #: Service of each word of ``poise mode``
#: Words of ``poise start``
START_STEPS = tuple(name.removeprefix(topics.START) for name in topics.START_SERVICES)
STOPS = ("damp", "estop")  #: Requests that may be repeated and are sent without delay
CALIBRATIONS = ("imu", "joints", "feet", "show", "rollback")  #: Words of ``poise calibrate``
CALIBRATION_TIMEOUT = 400.0  #: Longest wait for a calibration [s]; the timeout of the estimator is shorter


def mode(
    name: Annotated[
        str,
        typer.Argument(
            help="off, damp, stand or walk; also estop and reset_faults.", autocompletion=lambda: list(MODE_SERVICES)
        ),
    ],
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Request a mode of the running robot."""
    if name not in MODE_SERVICES:
        raise typer.BadParameter(f"unknown mode '{name}'; known: {', '.join(MODE_SERVICES)}")
    with connected(network, namespace) as client:
        raise typer.Exit(print_reply(client.trigger(MODE_SERVICES[name], at_once=name in STOPS)))


def start(
    step: Annotated[
        str,
        typer.Argument(help="confirm_gantry, prepare, lower, relax or damp.", autocompletion=lambda: list(START_STEPS)),
    ],
    on_enter: Annotated[
        bool, typer.Option("--on-enter", help="Connect now, and request the step each time Enter is pressed.")
    ] = False,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Confirm a step in the start of a real robot, or damp it; see docs/real_robot.md."""
    if step not in START_STEPS:
        raise typer.BadParameter(f"unknown step '{step}'; known: {', '.join(START_STEPS)}")
    with connected(network, namespace) as client:
        service = f"{topics.START}{step}"
        if on_enter:
            say(f"{client.await_trigger(service)}, Enter: {step}; Ctrl-C ends this command only")
            while client.wait(_typed, float("inf")) and sys.stdin.readline():
                try:
                    print_reply(client.trigger(service, at_once=step in STOPS))
                except PoiseError as error:  # the next request may succeed
                    say(f"{error}\nuse the remote controller; Enter tries again")
            raise typer.Exit
        raise typer.Exit(print_reply(client.trigger(service, at_once=step in STOPS)))


def _typed() -> bool:
    """Whether a line is available on the standard input."""
    return bool(select.select([sys.stdin], [], [], 0.0)[0])


def status(network: Network = False, namespace: Namespace = "") -> None:
    """Print what the running robot does, what is wrong, and what to do next."""
    with connected(network, namespace) as client:
        from bridge.ros.client import overview

        for name, text in overview(client).items():
            say(f"{name:>16}: {text}")


def walk(
    forward: Annotated[float | None, typer.Argument(help=r"Velocity forward; negative backward \[m/s].")] = None,
    left: Annotated[float, typer.Argument(help=r"Velocity to the left \[m/s].")] = 0.0,
    turn: Annotated[float, typer.Argument(help=r"Turning speed to the left \[rad/s].")] = 0.0,
    seconds: Annotated[
        float, typer.Option(min=0.0, help=r"Duration in robot time \[s]; then the robot stops and stands.")
    ] = 5.0,
    to: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help=r"Walk to x \[m], y \[m] and heading \[rad] in odom instead.", metavar="X Y YAW"),
    ] = None,
    around: Annotated[
        bool | None,
        typer.Option(
            "--around/--over",
            help="For this walk and later ones to a pose: walk around obstacles, or step onto them where possible; "
            "needs a map of the ground.",
        ),
    ] = None,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Have the running robot walk at a velocity, on /cmd_vel, or to a pose, on /goal_pose, then stand."""
    if to is None and forward is None:
        raise typer.BadParameter("give a velocity, or a pose with --to")
    if around is not None and to is None:
        raise typer.BadParameter("--around and --over are for walks to a pose: give one with --to")
    with connected(network, namespace) as client:
        from bridge.ros.walk import walk as drive
        from bridge.ros.walk import walk_to

        if to is not None:
            raise typer.Exit(print_reply(walk_to(client, to, around, typer.echo)))
        raise typer.Exit(print_reply(drive(client, (forward or 0.0, left, turn), seconds)))


def calibrate(
    what: Annotated[
        str,
        typer.Argument(help="imu, joints or feet; show or rollback.", autocompletion=lambda: list(CALIBRATIONS)),
    ],
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Have the running robot calibrate its sensors, show what is kept, or return to the file before it."""
    if what not in CALIBRATIONS:
        raise typer.BadParameter(f"unknown sensor '{what}'; known: {', '.join(CALIBRATIONS)}")
    with connected(network, namespace) as client:
        raise typer.Exit(print_reply(client.trigger(f"calibrate/{what}", answer_timeout=CALIBRATION_TIMEOUT)))


def identify(
    save: Annotated[Path | None, typer.Option(help="Profile to write with the result, for poise up --robot.")] = None,
    robot: Annotated[
        str, typer.Option(help="Profile that the result extends; by default that of the running robot.")
    ] = "",
    seconds: Annotated[float, typer.Option(min=0.5, help=r"Duration \[s].")] = 4.0,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Measure the payload and the CoM of the running robot, which stands still; the laws use them from a profile."""
    with connected(network, namespace) as client:
        from bridge.driver.foot_load import payload_profile
        from bridge.ros.identify import identify_payload
        from models.files import part_beside
        from models.robot_model import RobotModel

        name = robot or client.robot()
        model = RobotModel.load(name)
        found = identify_payload(client, model, seconds)
        stem = "" if save is None else re.sub(r"\W", "_", save.stem.lower())
        own = stem if re.match("[a-z]", stem) else model.name
        text = payload_profile(model.profile.source if robot else name, own, found, save)
        say(text.rstrip())
        if save is None:
            say("to write a profile: poise identify --save my_robot.yaml; to use it: poise up --robot my_robot.yaml")
        else:
            part = part_beside(save)
            part.write_text(text, encoding="utf-8")
            part.replace(save)
            say(f"written: {save}; to use it at the next start: poise up --robot {save}")


def hang(
    down: Annotated[bool, typer.Option("--down", help="Return the robot to its start.")] = False,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Have a crane lift the simulated robot, held or off, so that its feet are in the air."""
    with connected(network, namespace) as client:
        raise typer.Exit(print_reply(client.switch("hang", not down)))


def reset(network: Network = False, namespace: Namespace = "") -> None:
    """Put the simulated robot, fallen or not, back on its feet at its start, and wait until it stands."""
    with connected(network, namespace) as client:
        from bridge.ros.walk import reset as start_over

        raise typer.Exit(print_reply(start_over(client)))


def _words() -> list[str]:
    from controllers.safety.health import SupervisorConfig
    from controllers.safety.supervisor import GAIT_WORDS
    from models.config import default_config

    return [*default_config(SupervisorConfig, "controllers", "supervisor").motions, "stand", "stop", *GAIT_WORDS]


def send(
    text: Annotated[
        str,
        typer.Argument(
            help="wave, squat, crouch, bow, reach, stand, stop; until stop: forward, backward, left, right, turn, spin",
            autocompletion=_words,
        ),
    ],
    key: Annotated[
        Path | None, typer.Option(help="Sign the command with the key in this file; see docs/security.md.")
    ] = None,
    source: Annotated[str, typer.Option(help="Source of a signed command.")] = "teleop",
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Send a text command to the running robot and say what became of it."""
    with connected(network, namespace, key, source) as client:
        raise typer.Exit(print_reply(client.command(text)))


def reach(
    frame: Annotated[str, typer.Argument(help="left_hand, right_hand, head, base_link or torso.")],
    x: Annotated[float, typer.Argument(help=r"Forward \[m].")],
    y: Annotated[float, typer.Argument(help=r"Left \[m].")],
    z: Annotated[float, typer.Argument(help=r"Up \[m].")],
    of: Annotated[
        str, typer.Option("--in", help="Frame of the target: odom, base_footprint, or one of the robot.")
    ] = "base_link",
    duration: Annotated[float, typer.Option(min=0.0, help=r"Duration of the motion; 0: shortest possible \[s].")] = 0.0,
    plan_only: Annotated[
        bool, typer.Option("--plan-only", help="Report feasibility and duration; the robot does not move.")
    ] = False,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Have the standing robot bring a hand, its head or its pelvis to a place, or say why it cannot."""
    with connected(network, namespace) as client:
        from bridge.ros.walk import reach as go

        reply = go(client, frame, (x, y, z), frame_id=of, duration=duration, execute=not plan_only)
        raise typer.Exit(print_reply(reply))
