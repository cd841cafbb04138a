"""Brings lifecycle nodes of other processes to a state, through their services."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState

from models.errors import PoiseError

CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE
_LABELS = {CONFIGURE: "configure", ACTIVATE: "activate", DEACTIVATE: "deactivate"}
_UNCONFIGURED, _INACTIVE = State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE
_GOALS = {CONFIGURE: _INACTIVE, ACTIVATE: State.PRIMARY_STATE_ACTIVE, DEACTIVATE: _INACTIVE}
_STARTS = {CONFIGURE: _UNCONFIGURED, ACTIVATE: _INACTIVE, DEACTIVATE: State.PRIMARY_STATE_ACTIVE}

ASK_AGAIN = 1.0
"""Time without an answer after which a node is asked for its state [s]."""


class _Change:
    """One transition of one node.

    A reply is lost when the node has not yet discovered the reader for it, and DDS tells nobody. So a node that does
    not answer is asked for its state: the goal means that only the reply was lost, the start that the request was.
    One that refuses is asked too: it may be at the goal by an earlier request.
    """

    def __init__(self, node: Any, name: str, transition: int) -> None:
        self.name, self.done, self.refused = name, False, False
        self._transition = transition
        self._node = node
        self._change = node.create_client(ChangeState, f"{name}/change_state")
        self._get = node.create_client(GetState, f"{name}/get_state")
        self._reply: Any = None
        self._state: Any = None
        self._asked = 0.0

    def update(self) -> None:
        """Send what is due and look at what came."""
        now = time.monotonic()
        if self._reply is None:
            if self._change.service_is_ready() and self._get.service_is_ready():
                self._send(now)
        elif self._reply.done() and self._reply.result().success:
            self.done = True
        elif self._state is not None and self._state.done():
            state = self._state.result().current_state.id
            self._state = None
            if state == _GOALS[self._transition] or self._reply.done():
                self.done, self.refused = True, state != _GOALS[self._transition]
            elif state == _STARTS[self._transition]:
                self._send(now)
        elif now - self._asked > ASK_AGAIN or (self._reply.done() and self._state is None):
            self._asked = now
            self._state = self._get.call_async(GetState.Request())

    def _send(self, now: float) -> None:
        request = ChangeState.Request()
        request.transition.id = self._transition
        self._reply = self._change.call_async(request)
        self._asked = now

    def close(self) -> None:
        """Destroy the clients."""
        self._node.destroy_client(self._change)
        self._node.destroy_client(self._get)


def change_state(node: Any, spin: Callable[[], None], names: Sequence[str], transition: int, timeout: float) -> None:
    """Request a transition of several nodes at once and wait for all.

    Args:
        node: Node that calls.
        spin: Serves callbacks for a short while; raises to give up.
        names: Node names.
        transition: ``CONFIGURE``, ``ACTIVATE`` or ``DEACTIVATE``.
        timeout: Longest wait [s].

    Raises:
        PoiseError: A node does not answer in time or refuses; it is named.
    """
    end = time.monotonic() + timeout
    changes = [_Change(node, name, transition) for name in names]
    try:
        while left := [change for change in changes if not change.done]:
            for change in left:
                change.update()
            spin()
            if time.monotonic() > end:
                late = ", ".join(change.name for change in left)
                raise PoiseError(f"{late}: no answer to '{_LABELS[transition]}' in {timeout:.0f} s")
    finally:
        for change in changes:
            change.close()
    refused = [change.name for change in changes if change.refused]
    if refused:
        raise PoiseError(f"{', '.join(refused)}: refused to {_LABELS[transition]}; the log says why")
