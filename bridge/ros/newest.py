"""Messages of subscriptions without executor: messages between two polls cost nothing."""

from __future__ import annotations

from typing import Any


def ignore(message: Any) -> None:
    """Callback of polled subscriptions; never called."""


def newest(subscription: Any) -> bytes | None:
    """Newest serialised message of a raw subscription of depth 1, or None."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return None if taken is None else bytes(taken[0])
