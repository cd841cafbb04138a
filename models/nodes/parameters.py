"""A law's configuration as ROS parameters: declared from its schema, with description, range and read-only flag."""

import dataclasses
import inspect
import math
import re
import sys
import types
import typing
from collections.abc import Callable, Collection
from typing import Annotated, Any, TypeVar

from pydantic import Field
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from models.config import parse_config
from models.constants import NANOSECONDS

T = TypeVar("T")
S = TypeVar("S", bool, int, float, str)

_SCALARS = (bool, int, float, str)


def declare_config(node: Any, default: T, prefix: str = "", live: Collection[str] = ()) -> T:
    """Declare every field of a configuration as a parameter and return the configuration after overrides.

    Args:
        node: rclpy node.
        default: Configuration with the default values; nested dataclasses become dotted names.
        prefix: Put before every name, with its dot.
        live: Parameters, with their prefix, that may be changed while the node runs; the others are read-only.

    Raises:
        ConfigError: A value is out of range; the parameter is named.
    """
    values = _declare(node, default, prefix, live)
    return parse_config(type(default), values, f"parameters of {node.get_name()}")


def describe(
    description: str,
    *,
    read_only: bool = True,
    low: float | None = None,
    high: float | None = None,
    integer: tuple[int, int] | None = None,
) -> Any:
    """Descriptor of one parameter; ``low`` and ``high`` bound a float, ``integer`` an integer, None: unbounded."""
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    if integer is not None:
        descriptor.integer_range = [IntegerRange(from_value=integer[0], to_value=integer[1])]
    if low is not None or high is not None:
        most = sys.float_info.max
        descriptor.floating_point_range = [
            FloatingPointRange(
                from_value=float(low if low is not None else -most), to_value=float(high if high is not None else most)
            )
        ]
    return descriptor


def declare(node: Any, name: str, default: S, description: str, **bounds: Any) -> S:
    """Declare one read-only parameter and return its value; ``bounds`` are those of ``describe``."""
    value: S = node.declare_parameter(name, default, describe(description, **bounds)).value
    return value


def declare_ns(node: Any, name: str, default: float, description: str, **bounds: Any) -> int:
    """Declare a time [s] and return it in nanoseconds."""
    return round(NANOSECONDS * declare(node, name, default, description, **bounds))


def declare_period(node: Any, name: str, default: float, of: str, *, high: float = 1000.0) -> int:
    """Declare a rate of at least 1 Hz, described as ``Rate of ...``, and return its period [ns]."""
    return round(NANOSECONDS / declare(node, name, default, f"Rate of {of} [Hz]", low=1.0, high=high))


def declare_lockstep(node: Any) -> bool:
    """Declare the parameter ``lockstep`` that all nodes of the tick share."""
    text = "The plant waits for the command of each tick; sensors are then reliable (for deterministic tests)"
    return declare(node, "lockstep", False, text)


def _declare(node: Any, default: Any, prefix: str, live: Collection[str]) -> dict[str, Any]:
    """Declare the fields of one dataclass; returns their values by field name."""
    hints = typing.get_type_hints(type(default), include_extras=True)
    texts = _texts(type(default))
    values: dict[str, Any] = {}
    for field in dataclasses.fields(default):
        value = getattr(default, field.name)
        name = prefix + field.name
        if dataclasses.is_dataclass(value):
            values[field.name] = _declare(node, value, f"{name}.", live)
        elif isinstance(value, dict):
            hint = _descriptor_source(hints[field.name], texts(field.name))
            values[field.name] = {k: _declare_item(node, f"{name}.{k}", v, hint, live) for k, v in value.items()}
        else:
            hint = _descriptor_source(hints[field.name], texts(field.name))
            values[field.name] = _declare_item(node, name, value, hint, live)
    return values


def _texts(schema: type) -> Callable[[str], str]:
    """Description of a field from the schema's docstring: its entry under ``Attributes``, or the first sentence."""
    entries: dict[str, str] = {}
    head = ""
    for kind in reversed(schema.__mro__):  # inherited fields are described where they are written
        head, _, attributes = inspect.cleandoc(kind.__doc__ or "").partition("Attributes:")
        entries |= re.findall(r"^    (\w+): (.+(?:\n        .+)*)", attributes, re.MULTILINE)
    summary = head.strip().split("\n\n")[0].replace("\n", " ")
    return lambda name: re.sub(r"\s+", " ", entries.get(name, f"{name}: {summary}"))


def _descriptor_source(hint: Any, text: str) -> Any:
    """The type hint, with a description where it has none."""
    if any(getattr(info, "description", None) for info in _metadata(hint)):
        return hint
    return Annotated[hint, Field(description=text)]


def _declare_item(node: Any, name: str, value: Any, hint: Any, live: Collection[str]) -> Any:
    """Declare one value if ROS has a type for it, otherwise leave it at its default."""
    if dataclasses.is_dataclass(value):
        return _declare(node, value, f"{name}.", live)
    if isinstance(value, tuple | list) and value and all(type(item) in (float, str) for item in value):
        return list(node.declare_parameter(name, list(value), _descriptor(hint, None, name not in live)).value)
    if type(value) in _SCALARS:
        return node.declare_parameter(name, value, _descriptor(hint, type(value), name not in live)).value
    return _plain(value)


def _plain(value: Any) -> Any:
    """JSON form of a value that is not declared."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value


def _descriptor(hint: Any, kind: type | None, read_only: bool) -> Any:
    """Descriptor from ``Annotated[..., Field(...)]``. ROS ranges include their ends; the schema checks open ones."""
    description, low, high = "", -math.inf, math.inf
    for info in _metadata(hint):
        description = getattr(info, "description", None) or description
        for bound in getattr(info, "metadata", []):
            low = max(low, getattr(bound, "gt", -math.inf), getattr(bound, "ge", -math.inf))
            high = min(high, getattr(bound, "lt", math.inf), getattr(bound, "le", math.inf))
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    if (low, high) == (-math.inf, math.inf):
        return descriptor
    if kind is float:
        most = sys.float_info.max
        descriptor.floating_point_range = [FloatingPointRange(from_value=max(low, -most), to_value=min(high, most))]
    elif kind is int:
        most = 2**63 - 1
        descriptor.integer_range = [
            IntegerRange(from_value=int(max(low, -most)), to_value=int(high) if high < most else most)
        ]
    return descriptor


def _metadata(hint: Any) -> tuple[Any, ...]:
    """Metadata of an ``Annotated`` type, also inside ``Optional``."""
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        return tuple(item for part in typing.get_args(hint) for item in _metadata(part))
    return tuple(getattr(hint, "__metadata__", ()))
