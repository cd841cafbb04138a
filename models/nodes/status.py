"""Status records as messages of named, typed values.

The message is ``rcl_interfaces/ParameterEvent``: node, stamp, and one typed value per field. The type comes with
rclpy, so supervision needs no compiler, and all machines of a graph agree on the type.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import Parameter, parameter_value_to_python

from models.errors import MessageError
from models.nodes.qos import EVENT
from models.status import Status

T = TypeVar("T", bound=Status)

StatusMessage = ParameterEvent


def status_to_message(record: Status, node: str, stamp: Any) -> Any:
    """Message of a record; ``node`` is the fully qualified name, ``stamp`` a builtin_interfaces/Time."""
    values = msgspec.to_builtins(record)
    return StatusMessage(
        node=node,
        stamp=stamp,
        changed_parameters=[_parameter(name, value).to_parameter_msg() for name, value in values.items()],
    )


def status_from_message(message: Any, kind: type[T]) -> T:
    """Record of a message; ``MessageError`` names a missing or unknown field, or a field of wrong type."""
    values = {item.name: parameter_value_to_python(item.value) for item in message.changed_parameters}
    try:
        return msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        raise MessageError(f"{message.node[:64]}: {kind.__name__}: {error}") from error


def subscribe_status(node: Any, kind: type[T], topic: str, callback: Callable[[T], object], qos: Any = EVENT) -> Any:
    """Subscribe a plain rclpy node to a status record; malformed records are logged and dropped."""

    def on_message(message: Any) -> None:
        try:
            record = status_from_message(message, kind)
        except MessageError as error:
            node.get_logger().warning(f"{topic}: {error}", throttle_duration_sec=1.0)
            return
        callback(record)

    return node.create_subscription(StatusMessage, topic, on_message, qos)


def _parameter(name: str, value: Any) -> Parameter:
    if isinstance(value, list | tuple):
        return Parameter(name, Parameter.Type.STRING_ARRAY, list(value))
    return Parameter(name, value=value)
