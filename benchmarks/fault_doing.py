"""What all acts of ``poise bench faults`` are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeAlias

from bridge.closed_loop import ClosedLoop
from models.errors import PoiseError
from models.types import CommandReply

Doing: TypeAlias = Iterator[CommandReply | None]
"""One step of an act before each tick; what was answered, where something was asked."""

Act: TypeAlias = Callable[[ClosedLoop], Doing]
"""Something that is done to a robot."""


def asked(question: Callable[[], object]) -> CommandReply:
    """Ask for something that may be refused; the answer, with the reason."""
    try:
        question()
    except PoiseError as error:
        return CommandReply(False, str(error))
    return CommandReply(True, "done")


def unmet(what: str) -> CommandReply:
    """An answer that makes a row fail where nothing must be refused: something did not go as expected."""
    return CommandReply(False, what)


def pause(loop: ClosedLoop, duration: float) -> Doing:
    """Do nothing for a time [s]."""
    for _ in range(round(duration / loop.plant.period)):
        yield None


def says(*texts: str) -> Act:
    """The act that gives text commands, one in each tick."""

    def act(loop: ClosedLoop) -> Doing:
        for text in texts:
            yield loop.command(text)

    return act
