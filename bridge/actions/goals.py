"""One goal at a time: a newer one ends the older, and begins once the robot has stopped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from bridge.actions.robot import RobotClient
from models.errors import PoiseError

#: Reasons that end a goal, besides those of the robot
REPLACED, DEACTIVATED = "replaced by a newer goal", "the action server was deactivated"


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a goal ended, with the reason in ``message``; ``code`` is the action's error code, where it has one."""

    success: bool
    message: str
    cancelled: bool = False
    code: int = 0


class Turn:
    """The right of one goal, by its number, to move the robot."""

    def __init__(self, turns: Turns, number: int) -> None:
        self._turns, self._number = turns, number

    @property
    def ended(self) -> str:
        """Why the goal cannot go on; empty while it can."""
        if self._turns.newest != self._number:
            return REPLACED
        return DEACTIVATED if self._turns.closed else self._turns.robot.stopped


class Turns:
    """Gives the robot to one goal after the other; ``newest`` is the newest's number, ``closed`` set while inactive."""

    def __init__(self, robot: RobotClient) -> None:
        self.robot, self.newest, self.closed = robot, 0, False
        self._taken = False

    async def take(self) -> Turn:
        """End the goal before, and wait until it has ended."""
        self.newest += 1
        turn = Turn(self, self.newest)
        while self._taken:
            await self.robot.turn()
        self._taken = True
        return turn

    def release(self) -> None:
        """Report that the goal and its effect on the robot have ended."""
        self._taken = False


class Action(Protocol):
    """Behaviour of an action."""

    def refusal(self, request: Any) -> Outcome | None:
        """Why a goal is refused beforehand; None for a valid one."""
        ...

    async def run(self, handle: Any, turn: Turn) -> Outcome:
        """Execute the goal. Afterwards the robot is at rest or follows another client, whatever the outcome."""
        ...

    def result(self, outcome: Outcome) -> Any:
        """Result message of an outcome."""
        ...


def goal(turns: Turns, action: Action) -> Callable[[Any], Any]:
    """Action server callback; sets the goal's state by the outcome. A ``PoiseError`` aborts the goal with its text."""

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
