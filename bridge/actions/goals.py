"""One goal at a time: a newer one ends the older, and begins when that has stopped the robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from bridge.actions.ears import Ears
from models.errors import PoiseError

REPLACED, DEACTIVATED = "replaced by a newer goal", "the action server was deactivated"
"""Why a goal cannot go on, besides the robot's own reasons."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a goal ended.

    Attributes:
        success: Whether it was reached.
        message: Why not, or how.
        cancelled: Whether it was ended because somebody asked for it.
        code: What the action's own error code is, where it has one.
    """

    success: bool
    message: str
    cancelled: bool = False
    code: int = 0


class Turn:
    """The right of one goal to move the robot.

    Args:
        turns: Of all goals.
        number: Of this one.
    """

    def __init__(self, turns: Turns, number: int) -> None:
        self._turns, self._number = turns, number

    @property
    def ended(self) -> str:
        """Why the goal cannot go on; empty while it can."""
        if self._turns.newest != self._number:
            return REPLACED
        return DEACTIVATED if self._turns.closed else self._turns.ears.stopped


class Turns:
    """Gives the robot to one goal after the other.

    Args:
        ears: Hear what the robot does.

    Attributes:
        ears: The same.
        newest: Number of the newest goal.
        closed: Whether no goal may go on: the node is not active.
    """

    def __init__(self, ears: Ears) -> None:
        self.ears, self.newest, self.closed = ears, 0, False
        self._taken = False

    async def take(self) -> Turn:
        """Have the goal before end, and wait until it has."""
        self.newest += 1
        turn = Turn(self, self.newest)
        while self._taken:
            await self.ears.turn()
        self._taken = True
        return turn

    def release(self) -> None:
        """The goal has ended, and what it did to the robot too."""
        self._taken = False


class Action(Protocol):
    """What an action does."""

    def refusal(self, request: Any) -> Outcome | None:
        """Why a goal is refused before it does anything; None for a good one."""
        ...

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Do it. Whatever the outcome, the robot is at rest afterwards, or does what somebody else wants."""
        ...

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        ...


def goal(turns: Turns, action: Action) -> Callable[[Any], Any]:
    """Callback of an action server.

    Args:
        turns: Gives the robot to it.
        action: Does it.

    Returns:
        Coroutine function; it sets the goal's state by the outcome. An error of poise aborts the goal with its text.
    """

    async def execute(handle: Any) -> Any:
        outcome = action.refusal(handle.request)
        if outcome is None:
            turn = await turns.take()
            try:
                ended = turn.ended
                outcome = Outcome(False, ended) if ended else await action.run(handle, turn)
            except PoiseError as error:
                outcome = Outcome(False, str(error))
            finally:
                turns.release()
        if outcome.cancelled:
            handle.canceled()
        elif outcome.success:
            handle.succeed()
        else:
            handle.abort()
        return action.result(outcome)

    return execute
