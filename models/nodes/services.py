"""Services with types of this project, if these are built, and services with deferred responses."""

from collections.abc import Callable
from typing import Any

from models.errors import MessageError
from models.nodes.base import PoiseNode
from models.nodes.interfaces import interface

PACKAGE = "poise_interfaces"


def offer_own(
    node: PoiseNode,
    kind: str,
    name: str,
    callback: Callable[[Any, Any], Any],
    serve: Callable[[PoiseNode, type, str, Callable[[Any, Any], Any]], None] = PoiseNode.serve,
) -> None:
    """Offer a service until ``cleanup`` by ``serve`` or ``serve_later``; diagnostics report a missing type."""
    try:
        found = interface(PACKAGE, "srv", kind)
    except MessageError as error:
        node.values[PACKAGE] = str(error)
        return
    serve(node, found, name, callback)


def own_message(kind: str) -> Any:
    """Message type of ``poise_interfaces``."""
    return interface(PACKAGE, "msg", kind)


class Owed:
    """Deferred response of a service; a callback returns it in place of a response."""

    def __init__(self) -> None:
        self._send: Callable[[Any], None] | None = None
        self._response: Any = None

    def answer(self, response: Any) -> None:
        """Send the response, at once or after the callback has returned."""
        self._response = response
        self._deliver()

    def bind(self, send: Callable[[Any], None]) -> None:
        """Set the function that sends the response to the client."""
        self._send = send
        self._deliver()

    def _deliver(self) -> None:
        if self._send is not None and self._response is not None:
            send, response = self._send, self._response
            self._send = self._response = None
            send(response)


def serve_later(node: PoiseNode, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
    """Offer a service until ``cleanup``; its callback returns a response, or an ``Owed`` for a deferred response."""
    service = node.create_service(kind, name, callback)
    send = service.send_response

    def send_response(response: Any, header: Any) -> None:
        if isinstance(response, Owed):
            response.bind(lambda answer: send(answer, header))
        else:
            send(response, header)

    service.send_response = send_response  # type: ignore[method-assign]
    node.own(node.destroy_service, service)
