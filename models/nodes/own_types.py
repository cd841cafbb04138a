"""Services with types of this project, where these are built."""

from __future__ import annotations

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
    """Offer a service until ``cleanup``; where its type is absent, the node's diagnostics say so.

    Args:
        node: Node that offers it.
        kind: Name of its type.
        name: Of the service.
        callback: Takes request and response.
        serve: Offers it; ``serve_later`` where the answer may come later.
    """
    try:
        found = interface(PACKAGE, "srv", kind)
    except MessageError as error:
        node.values[PACKAGE] = str(error)
        return
    serve(node, found, name, callback)


def own_message(kind: str) -> Any:
    """Type of a message that such a service carries."""
    return interface(PACKAGE, "msg", kind)
