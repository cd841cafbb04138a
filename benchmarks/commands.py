"""Commands that a benchmark cannot do without."""

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
