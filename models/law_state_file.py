"""A captured state of a law as bytes and JSON, and back into a law that was built alike; never executes its content."""

from __future__ import annotations

from collections import deque
from enum import Enum
from importlib import import_module
from typing import Any

import numpy as np
from msgspec import Struct

from models.errors import PoiseError
from models.law_state import PACKAGES, Bytes, Captured, Held, LawState, attributes, owner

#: What a law hands itself within a tick; the next tick makes it anew
_MADE_ANEW = ("builtins:method", "builtins:function")
_SEQUENCES: dict[str, type] = {"list": list, "tuple": tuple, "deque": deque, "set": set}


def describe(law: LawState, captured: Captured) -> tuple[Bytes, dict[str, Any]]:
    """Bytes and description of a captured state."""
    return _Writer(law, captured).written()


def restore(law: LawState, data: Bytes, told: dict[str, Any]) -> None:
    """Restore a state in a law like the one it was captured from.

    Raises:
        PoiseError: The law is of another version than the one of the state.
    """
    if told["arrays"] != _arrays(law) or not set(told["objects"]) <= set(law.objects):
        raise PoiseError("the state of the laws is of another version of poise, or of other libraries")
    memory = data[: law.size].copy()
    for array, view in zip(law.sources, law.views(memory), strict=True):
        array[...] = view
    _Reader(law, data).put(told["objects"])


def _arrays(law: LawState) -> list[list[Any]]:
    return [[place, each.dtype.str, list(each.shape)] for place, each in law.arrays.items()]


class _Writer:
    def __init__(self, law: LawState, captured: Captured) -> None:
        self._law = law
        self._blobs = [captured.memory[: law.size]]
        self._size = law.size
        self._numbers: dict[int, int] = {}
        self._objects = {
            place: self._contents(law.objects[place], now)
            for place, now in zip(law.objects, captured.objects, strict=True)
            if now is not None
        }

    def _contents(self, target: Any, now: Any) -> dict[str, list[Any]]:
        """Items of a sequence, pairs of a dictionary or an object; an object keeps the laws that are apart."""
        if isinstance(now, list):
            return {"items": [self._write(each) for each in now]}
        kept = now if isinstance(target, dict) else {k: v for k, v in now.items() if not self._law.is_apart(v)}
        return {"pairs": [[self._write(key), self._write(each)] for key, each in kept.items()]}

    def written(self) -> tuple[Bytes, dict[str, Any]]:
        return np.concatenate(self._blobs), {"arrays": _arrays(self._law), "objects": self._objects}

    def _write(self, value: Any) -> Any:
        if value is None or type(value) in (bool, int, float, str):
            return value
        if (place := self._law.places.get(id(value))) is not None:
            return {"at": place}
        if id(value) in self._numbers:
            return {"same": self._numbers[id(value)]}
        if isinstance(value, Enum):
            return {"enum": [_name(type(value)), value.name]}
        if isinstance(value, np.generic):
            return {"number": self._blob(np.asarray(value))}
        if isinstance(value, np.ndarray) and (place := self._law.places.get(id(owner(value)))) is not None:
            begin = _address(value) - _address(owner(value))
            return {"view": [place, begin, value.dtype.str, list(value.shape), list(value.strides)]}
        if isinstance(value, bytes):
            return {"bytes": value.hex()}
        number = self._numbers[id(value)] = len(self._numbers)
        return {"new": number} | self._new(value)

    def _new(self, value: Any) -> dict[str, Any]:
        if isinstance(value, np.ndarray):
            return {"array": self._blob(value)}
        if isinstance(value, dict):
            return {"dict": [[self._write(key), self._write(each)] for key, each in value.items()]}
        name = next((name for name, sequence in _SEQUENCES.items() if type(value) is sequence), "")
        if name:
            return {name: [self._write(each) for each in value]}
        if isinstance(value, tuple) and hasattr(value, "_asdict"):
            return {"object": [_name(type(value)), {name: self._write(each) for name, each in value._asdict().items()}]}
        if isinstance(value, Held) or self._law.is_looked_into(value):
            kind = value.kind if isinstance(value, Held) else type(value)
            held = value.attributes if isinstance(value, Held) else attributes(value)
            return {"object": [_name(kind), {name: self._write(each) for name, each in held.items()}]}
        return {"keep": _name(type(value))}  # a constant: it stays as it is in the law that was built

    def _blob(self, value: np.ndarray[Any, Any]) -> list[Any]:
        data = np.frombuffer(np.ascontiguousarray(value).tobytes(), dtype=np.uint8)
        begin, self._size = self._size, self._size + len(data)
        self._blobs.append(data)
        return [value.dtype.str, list(value.shape), begin]


class _Reader:
    def __init__(self, law: LawState, data: Bytes) -> None:
        self._law, self._data = law, data
        self._made: dict[int, Any] = {}

    def put(self, objects: dict[str, Any]) -> None:
        for place, told in objects.items():
            target = self._law.objects[place]
            if "items" in told:
                was = list(target)
                items = [self._read(each, was[i] if i < len(was) else None) for i, each in enumerate(told["items"])]
                target.clear()
                if isinstance(target, set):
                    target.update(items)
                else:
                    target.extend(items)
                continue
            old = dict(target) if isinstance(target, dict) else attributes(target)
            pairs = {(name := self._read(key)): self._read(each, old.get(name)) for key, each in told["pairs"]}
            if isinstance(target, dict):
                target.clear()
                target.update(pairs)
            else:
                for name, each in pairs.items():
                    object.__setattr__(target, name, each)

    def _read(self, told: Any, old: Any = None) -> Any:
        if not isinstance(told, dict):
            return told
        if "at" in told:
            return self._law.found[told["at"]]
        if "same" in told:
            return self._made[told["same"]]
        if "enum" in told:
            kind, name = told["enum"]
            return getattr(_kind(kind), name)
        if "number" in told:
            return self._array(told["number"])[()]
        if "bytes" in told:
            return bytes.fromhex(told["bytes"])
        if "view" in told:
            place, begin, kind, shape, strides = told["view"]
            return np.ndarray(shape, np.dtype(kind), self._law.found[place], begin, strides)
        return self._build(told, old)

    def _build(self, told: dict[str, Any], old: Any) -> Any:
        made: Any = old
        if "keep" in told and old is None and told["keep"] not in _MADE_ANEW:
            raise PoiseError(f"the state of the laws holds '{told['keep'][:64]}', which cannot be put back")
        if "array" in told:
            made = self._array(told["array"])
        elif "dict" in told:
            made = {self._read(key): self._read(each) for key, each in told["dict"]}
        elif "object" in told:
            name, held = told["object"]
            kind = _kind(name)
            values = {name: self._read(each) for name, each in held.items()}
            if issubclass(kind, Struct | tuple):  # a named tuple
                made = kind(**values)
            else:
                made = object.__new__(kind)
                for name, each in values.items():
                    object.__setattr__(made, name, each)
        for name, sequence in _SEQUENCES.items():
            if name in told:
                made = sequence(self._read(each) for each in told[name])
        self._made[told["new"]] = made
        return made

    def _array(self, told: list[Any]) -> np.ndarray[Any, Any]:
        kind, shape, begin = told
        dtype = np.dtype(kind)
        end = begin + int(np.prod(shape)) * dtype.itemsize
        return np.frombuffer(self._data[begin:end].tobytes(), dtype=dtype).reshape(shape).copy()


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _kind(name: str) -> type:
    """A class of this project by name; nothing else is made."""
    module, _, path = name.partition(":")
    if module.split(".", 1)[0] in PACKAGES:
        kind: Any = import_module(module)
        for part in path.split("."):
            kind = getattr(kind, part, None)
        if isinstance(kind, type):
            return kind
    raise PoiseError(f"the state of the laws holds '{name[:64]}', which is not known")


def _address(array: np.ndarray[Any, Any]) -> int:
    return int(array.__array_interface__["data"][0])
