"""Messages to and from the text of a command line, as ``rosidl_runtime_py`` does it."""

import importlib
from typing import Any

import yaml

ITEMS_MAX = 128
"""Of a sequence, so many items are printed, as ``ros2 topic echo`` does [-]."""


def kind_of(name: str) -> Any:
    """Type of a name such as ``std_msgs/msg/String``."""
    package, kind, last = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), last)


def fill(message: Any, values: str | dict[str, Any]) -> Any:
    """Set fields from YAML; the others keep their defaults."""
    given = yaml.safe_load(values) if isinstance(values, str) else values
    for name, value in given.items():
        kind = message.get_fields_and_field_types()[name]
        before = getattr(message, name)
        if hasattr(before, "get_fields_and_field_types"):
            fill(before, value)
        elif kind.startswith("sequence<") and "/" in kind:
            package, _, last = kind.removeprefix("sequence<").rstrip(">").partition("/")
            item = kind_of(f"{package}/msg/{last}")
            setattr(message, name, [fill(item(), each) for each in value])
        else:
            setattr(message, name, value if isinstance(value, list) else type(before)(value))
    return message


def text_of(message: Any) -> str:
    """YAML of a message."""
    return yaml.safe_dump(_plain(message), sort_keys=False, allow_unicode=True)


def _plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, bytes):
        return value.hex()
    items = value.tolist() if hasattr(value, "tolist") else list(value)  # array.array and NumPy's, too
    return [_plain(each) for each in items[:ITEMS_MAX]]
