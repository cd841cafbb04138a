"""What a benchmark cannot do without: a command that is taken, a robot that does not fall."""

from __future__ import annotations

from benchmarks.contender_loop import AnyLoop
from models.errors import PoiseError


def demand(loop: AnyLoop, command: str) -> None:
    """Give a command that has to be taken.

    Args:
        loop: The robot.
        command: What ``ClosedLoop.command`` takes, such as 'walk'.

    Raises:
        PoiseError: It is refused; command and reason are told.
    """
    reply = loop.command(command)
    if not reply.accepted:
        raise PoiseError(f"{command}: {reply.reason}")


def keep_upright(loop: AnyLoop) -> None:
    """``PoiseError`` when the robot has fallen, saying how."""
    if loop.fallen:
        raise PoiseError(f"{loop.robot.name} fell: {loop.fall_reason}")


def advance(loop: AnyLoop, duration: float) -> None:
    """Run for a time [s]; ``PoiseError`` when the robot falls."""
    loop.run(duration)
    keep_upright(loop)
