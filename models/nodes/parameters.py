"""Configuration of a law as ROS parameters, declared from the schema with description, range and read-only flag."""

import dataclasses
import inspect
import math
import sys
import types
import typing
from collections.abc import Collection
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from models.config import descriptions, parse_config
from models.constants import NANOSECONDS

T = TypeVar("T")
S = TypeVar("S", bool, int, float, str)

_SCALARS = (bool, int, float, str)


def declare_config(node: Any, default: T, prefix: str = "", live: Collection[str] = ()) -> T:
    """Declare every field of a configuration as a parameter and return the configuration after overrides.

    Fields of nested dataclasses get dotted names after ``prefix``. Parameters in ``live`` may change while the node
    runs. Raises ``ConfigError``, which names a parameter out of range.
    """
    values = _declare(node, default, prefix, live)
    return parse_config(type(default), values, f"parameters of {node.get_name()}")


def describe(
    description: str,
    *,
    read_only: bool = True,
    low: float = -math.inf,
    high: float = math.inf,
    integer: tuple[int, int] | None = None,
) -> Any:
    """Descriptor of one parameter; ``low`` and ``high`` bound a float, ``integer`` an integer."""
    descriptor = ParameterDescriptor(description=description, read_only=read_only)
    if integer is not None:
        descriptor.integer_range = [IntegerRange(from_value=integer[0], to_value=integer[1])]
    if (low, high) != (-math.inf, math.inf):
        most = sys.float_info.max
        bounds = FloatingPointRange(from_value=float(max(low, -most)), to_value=float(min(high, most)))
        descriptor.floating_point_range = [bounds]
    return descriptor


def declare(node: Any, name: str, default: S, description: str, **bounds: Any) -> S:
    """Declare one read-only parameter and return its value; ``bounds`` are arguments of ``describe``."""
    value: S = node.declare_parameter(name, default, describe(description, **bounds)).value
    return value


def declare_ns(node: Any, name: str, default: float, description: str, **bounds: Any) -> int:
    """Declare a time [s] and return it in nanoseconds."""
    return round(NANOSECONDS * declare(node, name, default, description, **bounds))


def declare_period(node: Any, name: str, default: float, of: str, *, high: float = 1000.0) -> int:
    """Declare a rate of at least 1 Hz, described as ``Rate of ...``, and return its period [ns]."""
    return round(NANOSECONDS / declare(node, name, default, f"Rate of {of} [Hz]", low=1.0, high=high))


def declare_lockstep(node: Any) -> tuple[bool, bool]:
    """Declare the parameters ``lockstep`` and ``waits`` of the nodes of a tick; ``lockstep`` implies ``waits``."""
    text = "The plant waits for the command of each tick (for deterministic tests)"
    lockstep: bool = declare(node, "lockstep", False, text)
    text = "The plant waits for late commands: no sample is dropped or late, and a repeated one is answered again"
    return lockstep, declare(node, "waits", False, text) or lockstep


def _declare(node: Any, default: Any, prefix: str, live: Collection[str]) -> dict[str, Any]:
    """Declare the fields of one dataclass, with their comments as descriptions; returns the values by field name."""
    schema: Any = type(default)
    hints, texts = typing.get_type_hints(schema, include_extras=True), descriptions(schema)
    summary = inspect.cleandoc(schema.__doc__ or "").partition("\n\n")[0].replace("\n", " ")
    values: dict[str, Any] = {}
    for field in dataclasses.fields(default):
        value, name, hint = getattr(default, field.name), prefix + field.name, hints[field.name]
        text = texts.get(field.name, f"{field.name}: {summary}")
        if isinstance(value, dict):
            items = {key: _declare_item(node, f"{name}.{key}", item, hint, text, live) for key, item in value.items()}
            values[field.name] = items
        else:
            values[field.name] = _declare_item(node, name, value, hint, text, live)
    return values


def _declare_item(node: Any, name: str, value: Any, hint: Any, text: str, live: Collection[str]) -> Any:
    """Declare one value if ROS has a type for it; otherwise return the default."""
    if dataclasses.is_dataclass(value):
        return _declare(node, value, f"{name}.", live)
    if isinstance(value, tuple | list) and value and all(type(item) in (float, str) for item in value):
        return list(node.declare_parameter(name, list(value), describe(text, read_only=name not in live)).value)
    if type(value) in _SCALARS:
        return node.declare_parameter(name, value, _descriptor(hint, text, type(value), name not in live)).value
    return _plain(value)


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value


def _descriptor(hint: Any, text: str, kind: type, read_only: bool) -> Any:
    """Descriptor with the bounds of ``Annotated``. ROS ranges include their ends; the schema checks open bounds."""
    low, high = -math.inf, math.inf
    for info in _metadata(hint):
        text = getattr(info, "description", None) or text
        for bound in getattr(info, "metadata", []):
            low = max(low, getattr(bound, "gt", -math.inf), getattr(bound, "ge", -math.inf))
            high = min(high, getattr(bound, "lt", math.inf), getattr(bound, "le", math.inf))
    if kind is int and (low, high) != (-math.inf, math.inf):
        most = 2**63 - 1
        return describe(text, read_only=read_only, integer=(int(max(low, -most)), int(high) if high < most else most))
    if kind is float:
        return describe(text, read_only=read_only, low=low, high=high)
    return describe(text, read_only=read_only)


def _metadata(hint: Any) -> tuple[Any, ...]:
    """Metadata of an ``Annotated`` type, also within ``Optional``."""
    if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union:
        return tuple(item for part in typing.get_args(hint) for item in _metadata(part))
    return tuple(getattr(hint, "__metadata__", ()))
