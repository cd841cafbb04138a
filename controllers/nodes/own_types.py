"""Services of the supervisor with types of this project, where these are built."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from models.nodes.base import PoiseNode
from models.nodes.own_types import offer_own
from models.types import CommandReply

SET_MODE, COMMAND = "set_mode", "command"
"""Names of the services."""


def offer_own_types(
    node: PoiseNode, set_mode: Callable[[str], CommandReply], say: Callable[[str], CommandReply]
) -> None:
    """Offer ``set_mode`` and ``command`` until ``cleanup``; where their types are absent, the diagnostics say so.

    Args:
        node: Node that offers them.
        set_mode: Asks for a mode by its name.
        say: Answers a text command.
    """

    def answer(response: Any, act: Callable[[], CommandReply]) -> Any:
        reply = act() if node.active else CommandReply(False, f"{node.get_name()} is not active")
        response.success, response.message = reply.accepted, reply.reason
        return response

    offer_own(node, "SetMode", SET_MODE, lambda request, response: answer(response, lambda: set_mode(request.mode)))
    offer_own(node, "Command", COMMAND, lambda request, response: answer(response, lambda: say(request.text)))
