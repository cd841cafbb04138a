"""One goal at a time: a newer one ends the older, as does a robot that no longer stands or walks."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from bridge.actions.ears import Ears
from models.errors import PoiseError


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a goal ended.

    Attributes:
        success: Whether it was reached.
        message: Why not, or how.
        cancelled: Whether it was ended because somebody asked for it.
    """

    success: bool
    message: str
    cancelled: bool = False


class Turns:
    """Numbers the goals of all actions, so that each knows when a newer one has taken the robot over."""

    def __init__(self, ears: Ears) -> None:
        self._ears, self._newest = ears, 0

    def begin(self) -> Callable[[], str]:
        """Take the robot over.

        Returns:
            Function that says why the goal cannot go on; empty while it can.
        """
        self._newest += 1
        mine = self._newest

        def ended() -> str:
            return "replaced by a newer goal" if mine != self._newest else self._ears.stopped

        return ended


def goal(act: Callable[[Any], Awaitable[Outcome]], result: Callable[[Outcome], Any]) -> Callable[[Any], Any]:
    """Callback of an action server from what an action does.

    Args:
        act: Does it, with the goal's handle.
        result: Makes the action's result.

    Returns:
        Coroutine function; it sets the goal's state by the outcome. An error of poise aborts the goal with its text.
    """

    async def execute(handle: Any) -> Any:
        try:
            outcome = await act(handle)
        except PoiseError as error:
            outcome = Outcome(False, str(error))
        if outcome.cancelled:
            handle.canceled()
        elif outcome.success:
            handle.succeed()
        else:
            handle.abort()
        return result(outcome)

    return execute
