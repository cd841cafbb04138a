"""YAML configuration. A frozen pydantic dataclass is the schema; every error names the file and the key."""

import inspect
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import yaml
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from models.errors import ConfigError, did_you_mean

T = TypeVar("T")

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Fraction = Annotated[float, Field(gt=0.0, lt=1.0)]
Share = Annotated[float, Field(gt=0.0, le=1.0)]
Proportion = Annotated[float, Field(ge=0.0, le=1.0)]
Count = Annotated[int, Field(ge=1)]
#: Configuration of every schema dataclass: unknown keys, wrong types, NaN and infinity are refused
STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, arbitrary_types_allowed=False)


class _UniqueKeyLoader(yaml.CSafeLoader):
    """Safe loader that refuses duplicate keys."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    "while reading a mapping", node.start_mark, f"key '{key}' is given twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(path: Path) -> dict[str, Any]:
    """Read one YAML mapping; ``ConfigError`` for a missing file, invalid YAML, a duplicate key or another type."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_yaml(text, str(path))


def parse_yaml(text: str | bytes, source: str) -> dict[str, Any]:
    """Parse one YAML mapping; ``source`` names it in errors. Raises ``ConfigError`` as ``read_yaml`` does."""
    try:
        data = yaml.load(text, Loader=_UniqueKeyLoader)
    except yaml.YAMLError as error:
        raise ConfigError(f"{source}: not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{source}: expected a mapping of keys, found {type(data).__name__}")
    return data


def parse_config(schema: type[T], data: dict[str, Any], source: str) -> T:
    """Validate a mapping against a pydantic dataclass; ``ConfigError`` names ``source`` and every wrong key."""
    try:
        return TypeAdapter(schema).validate_json(json.dumps(data))
    except TypeError as error:
        raise ConfigError(f"{source}: {error}") from error
    except ValidationError as error:
        known = tuple(each.name for each in fields(cast(Any, schema)))
        lines = []
        for item in error.errors():
            key, wrong = ".".join(str(part) for part in item["loc"]), item["type"] == "unexpected_keyword_argument"
            near = did_you_mean(key, known) if wrong else ""
            lines.append(f"{key or '(top)'}: {item['msg']}{near}")
        raise ConfigError(f"{source}: " + "; ".join(lines)) from error


def refuse_unknown(data: Mapping[Any, object], known: Sequence[str], source: str) -> None:
    """Raise ``ConfigError``, which names ``source``, for an unknown key of a mapping."""
    for key in data:
        if key not in known:
            raise ConfigError(f"{source}: unknown key '{key}'; known: {', '.join(known)}")


def load_config(schema: type[T], path: Path) -> T:
    """Read and validate a YAML file; raises ``ConfigError`` as ``read_yaml`` and ``parse_config`` do."""
    return parse_config(schema, read_yaml(path), str(path))


def merged(base: Mapping[Any, Any], overlay: Mapping[Any, Any]) -> dict[str, Any]:
    """Recursive merge of two mappings; values of ``overlay`` replace those of ``base``."""
    both = {key for key in base if isinstance(base[key], Mapping) and isinstance(overlay.get(key), Mapping)}
    return {**base, **overlay, **{key: merged(base[key], overlay[key]) for key in both}}


def overlaid(config: T, overlay: Mapping[str, Any], source: str) -> T:
    """Copy of a configuration with values replaced by nested keys; ``ConfigError`` names every wrong key."""
    if not overlay:
        return config
    return parse_config(type(config), merged(asdict(cast(Any, config)), overlay), source)


_PACKAGED: dict[tuple[type[Any], str, str], Any] = {}


def default_config(schema: type[T], package: str, name: str) -> T:
    """Packaged default ``<package>/config/<name>.yaml``, read once per process."""
    key = schema, package, name
    if key not in _PACKAGED:
        _PACKAGED[key] = load_config(schema, Path(str(files(package))) / "config" / f"{name}.yaml")
    config: T = _PACKAGED[key]
    return config


@cache
def descriptions(schema: type[Any]) -> dict[str, str]:
    """``#:`` comments of the fields of a schema and its base classes, by field name."""
    found: dict[str, str] = {}
    for kind in reversed(schema.__mro__[:-1]):
        body = re.search(rf"^class {kind.__name__}\b.*?(?=^\S|\Z)", _source(kind.__module__), re.MULTILINE | re.DOTALL)
        fields = re.findall(r"^((?: +#: .*\n)*)    (\w+): (.*)$", body[0] if body else "", re.MULTILINE)
        texts = {name: (above or beside.partition("  #: ")[2]).replace("#:", "") for above, name, beside in fields}
        found |= {name: " ".join(text.split()) for name, text in texts.items() if text}
    return found


@cache
def _source(module: str) -> str:
    return inspect.getsource(sys.modules[module])
