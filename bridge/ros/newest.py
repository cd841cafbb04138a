"""Messages of subscriptions that belong to no executor: what arrives between two looks costs nothing here."""

from __future__ import annotations

from typing import Any


def ignore(message: Any) -> None:
    """Callback of subscriptions that are polled; nothing ever calls it."""


def newest(subscription: Any) -> bytes | None:
    """Newest serialised message of a raw subscription of depth 1, or None when nothing new has come."""
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    return None if taken is None else bytes(taken[0])
