"""Namespace of a robot: valid names, and the global topics that move into it."""

from typing import Any

from rclpy.exceptions import InvalidNamespaceException
from rclpy.validate_namespace import validate_namespace

from models.errors import PoiseError

#: Absolute topics that are remapped into the namespace, as in Nav2
GLOBAL_TOPICS = ("/clock", "/diagnostics", "/tf", "/tf_static")


def absolute_namespace(namespace: str) -> str:
    """Namespace with a leading slash, empty for none; ``PoiseError`` for an invalid name."""
    given = namespace.strip("/")
    if not given:
        return ""
    try:
        validate_namespace(f"/{given}")
    except InvalidNamespaceException as error:
        raise PoiseError(f"namespace '{namespace}': {str(error).splitlines()[0]}") from error
    return f"/{given}"


def namespace_rules() -> list[str]:
    """Arguments after ``--ros-args`` that remap ``GLOBAL_TOPICS`` into the namespace of the node."""
    return [word for topic in GLOBAL_TOPICS for word in ("-r", f"{topic}:={topic.removeprefix('/')}")]


def in_namespace(namespace: str) -> dict[str, Any]:
    """Keyword arguments of an rclpy node in a namespace in the form of ``absolute_namespace``."""
    if not namespace:
        return {}
    return {"namespace": namespace, "cli_args": ["--ros-args", *namespace_rules()]}
