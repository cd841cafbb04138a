"""Brings lifecycle nodes of other processes to a state, through their services."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from models.errors import PoiseError

CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
_LABELS = {CONFIGURE: "configure", ACTIVATE: "activate"}


class LifecycleClient:
    """Requests transitions and waits for the answers.

    Args:
        node: Node that calls.
        spin: Serves callbacks for a short while; raises to give up.
    """

    def __init__(self, node: Any, spin: Callable[[], None]) -> None:
        self._node, self._spin = node, spin
        self._clients: dict[str, Any] = {}

    def change(self, names: Sequence[str], transition: int, timeout: float) -> None:
        """Request a transition of several nodes at once and wait for all.

        Args:
            names: Node names.
            transition: ``CONFIGURE`` or ``ACTIVATE``.
            timeout: Longest wait [s].

        Raises:
            PoiseError: A node does not answer in time or refuses; it is named.
        """
        end = time.monotonic() + timeout
        waiting = list(names)
        futures: dict[str, Any] = {}
        while waiting or any(not future.done() for future in futures.values()):
            for name in list(waiting):
                client = self._client(name)
                if client.service_is_ready():
                    request = ChangeState.Request()
                    request.transition.id = transition
                    futures[name] = client.call_async(request)
                    waiting.remove(name)
            self._spin()
            if time.monotonic() > end:
                late = waiting + [name for name, future in futures.items() if not future.done()]
                raise PoiseError(f"{', '.join(late)}: no answer to '{_LABELS[transition]}' in {timeout:.0f} s")
        refused = [name for name, future in futures.items() if not future.result().success]
        if refused:
            raise PoiseError(f"{', '.join(refused)}: refused to {_LABELS[transition]}; the log says why")

    def forget(self, name: str) -> None:
        """Drop the connection to a node that has ended."""
        client = self._clients.pop(name, None)
        if client is not None:
            self._node.destroy_client(client)

    def _client(self, name: str) -> Any:
        if name not in self._clients:
            self._clients[name] = self._node.create_client(ChangeState, f"{name}/change_state")
        return self._clients[name]
