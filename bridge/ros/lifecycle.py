"""Lifecycle transitions of several nodes, requested until each has answered."""

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

REPORT_PERIOD = 10.0  #: Time between two reports of the nodes that are awaited [s]
ASK_AGAIN = 1.0  #: Time without an answer after which a node's state is requested [s]


class _Change:
    """One transition of one node.

    A reply is lost when the node has not yet discovered the reader, and DDS does not report that. The state of a node
    that does not answer is therefore requested. The goal state means that the reply was lost. The start state means
    that the request was lost if two answers have it; a busy node can give one such answer before its transition begins.
    The state is also requested after a refusal, as an earlier request may have reached the goal.
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
        self._unchanged = False  # whether an answer since the last request was that the transition had not begun

    def update(self) -> None:
        """Send what is due and process replies."""
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
                if self._unchanged:
                    self._send(now)
                else:
                    self._unchanged = True
        elif now - self._asked > ASK_AGAIN or (self._reply.done() and self._state is None):
            self._asked = now
            self._state = self._get.call_async(GetState.Request())

    def _send(self, now: float) -> None:
        request = ChangeState.Request()
        request.transition.id = self._transition
        self._reply = self._change.call_async(request)
        self._asked, self._unchanged = now, False

    def close(self) -> None:
        """Destroy the clients."""
        self._node.destroy_client(self._change)
        self._node.destroy_client(self._get)


def change_state(
    node: Any,
    spin: Callable[[], None],
    names: Sequence[str],
    transition: int,
    timeout: float,
    say: Callable[[str], object] = lambda text: None,
) -> None:
    """Request a transition (``CONFIGURE``, ``ACTIVATE`` or ``DEACTIVATE``) of several nodes at once and wait for all.

    ``spin`` serves callbacks for a short time; it raises to abort. Raises ``PoiseError`` with the name of a node that
    refuses or does not answer within ``timeout`` [s]. ``say`` receives the nodes that are awaited, every
    ``REPORT_PERIOD`` seconds.
    """
    begin = time.monotonic()
    end, report = begin + timeout, begin + REPORT_PERIOD
    changes = [_Change(node, name, transition) for name in names]
    try:
        while left := [change for change in changes if not change.done]:
            for change in left:
                change.update()
            spin()
            if (now := time.monotonic()) > report:
                report = now + REPORT_PERIOD
                awaited = ", ".join(change.name for change in left)
                say(
                    f"waiting for '{_LABELS[transition]}' of {awaited} for {now - begin:.0f} s, at most {timeout:.0f} s"
                )
            if now > end:
                late = ", ".join(change.name for change in left)
                kept = "compiled code is kept: try again"
                raise PoiseError(f"{late}: no answer to '{_LABELS[transition]}' in {timeout:.0f} s; {kept}")
    finally:
        for change in changes:
            change.close()
    refused = [change.name for change in changes if change.refused]
    if refused:
        raise PoiseError(f"{', '.join(refused)}: refused to {_LABELS[transition]}; the log has the reason")
