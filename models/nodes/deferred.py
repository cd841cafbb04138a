"""Services that answer later, while their node goes on.

A coroutine as callback would say the same, but rclpy's events executor does not await it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from models.nodes.base import PoiseNode


class Owed:
    """Answer that a service owes its client; a callback returns it in the place of a response."""

    def __init__(self) -> None:
        self._send: Callable[[Any], None] | None = None
        self._response: Any = None

    def answer(self, response: Any) -> None:
        """Send the response, at once or as soon as the callback has returned."""
        self._response = response
        self._deliver()

    def bind(self, send: Callable[[Any], None]) -> None:
        """Told by the service how the response reaches the client."""
        self._send = send
        self._deliver()

    def _deliver(self) -> None:
        if self._send is not None and self._response is not None:
            send, response = self._send, self._response
            self._send = self._response = None
            send(response)


def serve_later(node: PoiseNode, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
    """Offer a service until ``cleanup`` whose callback returns a response, or an ``Owed`` that is answered later.

    Args:
        node: Node that offers it.
        kind: Service type.
        name: Name of the service.
        callback: Takes request and response.
    """
    service = node.create_service(kind, name, callback)
    send = service.send_response

    def send_response(response: Any, header: Any) -> None:
        if isinstance(response, Owed):
            response.bind(lambda answer: send(answer, header))
        else:
            send(response, header)

    service.send_response = send_response  # type: ignore[method-assign]
    node.own(node.destroy_service, service)
