"""Messages to and from the text of a command line, as ``rosidl_runtime_py`` does it."""

import importlib
from typing import Any

import yaml

ITEMS_MAX = 128
"""Of a sequence, so many items are printed, as ``ros2 topic echo`` does [-]."""


def kind_of(name: str) -> Any:
    """Type of a name such as ``std_msgs/msg/String``; ``ValueError`` when there is none."""
    try:
        package, kind, last = name.split("/")
        return getattr(importlib.import_module(f"{package}.{kind}"), last)
    except (ValueError, ImportError, AttributeError) as error:
        raise ValueError(f"'{name}' is no type of an interface, such as std_msgs/msg/String: {error}") from error


def fill(message: Any, values: str | dict[str, Any]) -> Any:
    """Set fields from YAML; the others keep their defaults. ``ValueError`` names a field that is wrong."""
    try:
        given = yaml.safe_load(values) if isinstance(values, str) else values
    except yaml.YAMLError as error:
        raise ValueError(f"{values!r} is no YAML: {' '.join(str(error).split())}") from error
    fields = message.get_fields_and_field_types()
    kinds = ", ".join(f"{name}: {kind}" for name, kind in fields.items())
    if not isinstance(given, dict):
        raise ValueError(f"{given!r} does not name fields, as '{{NAME: VALUE}}'; they are {{{kinds}}}")
    for name, value in given.items():
        if name not in fields:
            raise ValueError(f"{type(message).__name__} has no field '{name}'; its fields are {{{kinds}}}")
        kind, before = fields[name], getattr(message, name)
        if hasattr(before, "get_fields_and_field_types"):
            fill(before, value)
        elif kind.startswith("sequence<") and "/" in kind and isinstance(value, list):
            package, _, last = kind.removeprefix("sequence<").split(">")[0].split(",")[0].partition("/")
            item = kind_of(f"{package}/msg/{last}")
            setattr(message, name, [fill(item(), each) for each in value])
        else:
            try:
                if isinstance(before, bool) is not isinstance(value, bool):
                    raise TypeError(value)
                setattr(message, name, value if isinstance(value, list) else type(before)(value))
            except (TypeError, ValueError, AssertionError, OverflowError) as error:
                raise ValueError(f"{name}: {value!r} is no {kind}") from error
    return message


def field_of(message: Any, path: str | None) -> Any:
    """Value at a path such as ``info.resolution``, the message itself without one; ``ValueError`` names its fields."""
    for name in path.split(".") if path else ():
        fields = getattr(message, "get_fields_and_field_types", dict)()
        if name not in fields:
            raise ValueError(f"--field {path}: there is no '{name}'; the fields are {', '.join(fields) or 'none'}")
        message = getattr(message, name)
    return message


def text_of(message: Any) -> str:
    """YAML of a message or of a field; ``...`` stands for the items of a sequence after ``ITEMS_MAX``."""
    text: str = yaml.safe_dump(_plain(message), sort_keys=False, allow_unicode=True)
    return text[:-4] if text.endswith("\n...\n") else text  # the end of a document, after a single value


def _plain(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, bytes):
        return value.hex()
    items = value.tolist() if hasattr(value, "tolist") else list(value)  # array.array and NumPy's, too
    return [*(_plain(each) for each in items[:ITEMS_MAX]), *(["..."] if len(items) > ITEMS_MAX else [])]
