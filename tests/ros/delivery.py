"""Hands messages to a node's subscribers without the middleware."""

from typing import Any


def deliver(node: Any, topic: str, message: Any) -> None:
    """Call the subscriber of a topic in a node with a message, serialised where it takes bytes."""
    name = node.resolve_topic_name(topic)
    (subscription,) = (each for each in node.subscriptions if each.topic_name == name)
    subscription.callback(message)
