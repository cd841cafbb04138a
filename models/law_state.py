"""The state of a law, copied within a tick and restored bit for bit in a law that was built alike.

A law keeps its state in arrays that compiled kernels write to, and in attributes. ``LawState`` finds all of it once,
when the law has just been built: every array that owns memory, and every object of this project that can change.
``capture`` then copies the arrays into preallocated memory and records the attributes; objects made since (a
reference, a plan) are copied with them. The laws take no part, so a change of a law cannot leave state out. Constants
are excluded: the robot, configurations, objects of other libraries.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum
from operator import is_
from types import FunctionType, MethodType
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from models.robot_model import RobotModel
from models.trajectory import TrajectorySampler

PACKAGES = ("models", "planners", "controllers")  #: Whose objects are looked into
_LEFT = (RobotModel, type, FunctionType, MethodType)
_ATOMS = frozenset({bool, int, float, str, bytes, type(None)})
_CONTAINERS = (list, dict, deque, set)
#: Made once and never changed: held as they are, because to copy them would take long
_UNCHANGING = (TrajectorySampler,)
Bytes = NDArray[np.uint8]


@dataclass(slots=True)
class Held:
    """An object created since the construction: its class and its attributes."""

    kind: type
    attributes: dict[str, Any]


@dataclass(slots=True)
class Captured:
    """Result of ``LawState.capture``."""

    memory: Bytes  # contents of the arrays, one after the other
    objects: list[Any]  # attributes and contents, in the order of ``LawState.objects``; None when unchanged


class LawState:
    """Location of the state of a law that has just been built, except objects in ``apart``: separate laws.

    Attributes:
        arrays: Arrays that own their memory, by where they were found.
        objects: Objects, lists and dictionaries that can change, by where they were found.
        places: Path of each array and object, by its id.
        found: Each array and object, by its path.
        sources: The same arrays, flat where contiguous, which copies fastest.
        size: Memory of the arrays [bytes].
    """

    def __init__(self, law: object, apart: Collection[object] = ()) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}
        self.objects: dict[str, Any] = {}
        self.places: dict[int, str] = {}
        self.found: dict[str, Any] = {}
        self._apart = {id(each) for each in apart}
        self._find(law, "")
        self.sources = [each.reshape(-1) if each.flags.c_contiguous else each for each in self.arrays.values()]
        self._live = [each if isinstance(each, _CONTAINERS) else _live(each) for each in self.objects.values()]
        contents = [_contents(each) for each in self._live]
        self._built = [tuple(each.values() if isinstance(each, dict) else each) for each in contents]
        self.size = sum(-(-each.nbytes // 8) * 8 for each in self.arrays.values())

    def _find(self, value: Any, place: str) -> None:
        if id(value) in self.places:
            return
        if isinstance(value, np.ndarray):
            self._find_array(value, place)
        elif isinstance(value, _CONTAINERS):
            self._keep(value, place)
            self.objects[place] = value
            for key, each in value.items() if isinstance(value, dict) else enumerate(value):
                self._find(each, f"{place}[{key!r}]")
        elif isinstance(value, tuple):
            self._keep(value, place)
            for i, each in enumerate(value):
                self._find(each, f"{place}[{i}]")
        elif self.is_looked_into(value):
            self._keep(value, place)
            if not is_frozen(value):
                self.objects[place] = value
            for name, each in attributes(value).items():
                self._find(each, f"{place}.{name}")

    def _find_array(self, value: NDArray[Any], place: str) -> None:
        self._keep(value, place)
        base = owner(value)
        if id(base) not in self.places:
            self._keep(base, f"{place}^")
        if base.flags.writeable and self.places[id(base)] not in self.arrays:
            self.arrays[self.places[id(base)]] = base

    def _keep(self, value: object, place: str) -> None:
        self.places[id(value)] = place
        self.found[place] = value  # and lives, so that its id stays its own

    def is_apart(self, value: object) -> bool:
        """Whether an object is a separate law, or a record of the inputs of the laws."""
        return id(value) in self._apart

    def is_looked_into(self, value: object) -> bool:
        """Whether an object is of this project, and neither a constant nor apart."""
        return not self.is_apart(value) and is_ours(value)

    def memory(self) -> Bytes:
        """Memory that ``capture`` can fill; touched, so that no page is missing later."""
        return np.full(self.size, 1, dtype=np.uint8)

    def views(self, memory: Bytes) -> list[NDArray[Any]]:
        """The part of a memory that belongs to each array."""
        views: list[NDArray[Any]] = []
        begin = 0
        for array in self.sources:
            views.append(memory[begin : begin + array.nbytes].view(array.dtype).reshape(array.shape))
            begin += -(-array.nbytes // 8) * 8
        return views

    def capture(self, memory: Bytes, views: list[NDArray[Any]]) -> Captured:
        """Copy the state into ``memory`` through its ``views``; both come from ``memory()``."""
        for view, array in zip(views, self.sources, strict=True):
            view[...] = array
        known, memo = self.places, dict[int, Any]()
        hold = self._hold
        objects: list[Any] = []
        for each, built in zip(self._live, self._built, strict=True):
            now = each if type(each) is dict else _contents(each)
            if len(now) == len(built) and all(map(is_, now.values() if type(now) is dict else now, built)):
                objects.append(None)
            elif type(now) is dict:
                objects.append(
                    {
                        name: value if type(value) in _ATOMS or id(value) in known else hold(value, memo)
                        for name, value in now.items()
                    }
                )
            else:
                objects.append([hold(one, memo) for one in now])
        return Captured(memory, objects)

    def _hold(self, value: Any, memo: dict[int, Any]) -> Any:
        """A copy of objects made since the construction; known objects are kept as references."""
        if type(value) in _ATOMS or id(value) in self.places or isinstance(value, (*_LEFT, *_UNCHANGING, Enum)):
            return value
        if id(value) in memo:
            return memo[id(value)][0]
        held: Any = value
        if isinstance(value, np.ndarray):
            held = value if id(owner(value)) in self.places else value.copy()
        elif isinstance(value, dict):
            held = {key: self._hold(each, memo) for key, each in value.items()}
        elif isinstance(value, (list, tuple, deque, set)):
            make = getattr(type(value), "_make", type(value))  # a NamedTuple takes its fields one by one
            held = make(self._hold(each, memo) for each in value)
        elif self.is_looked_into(value):
            held = Held(type(value), {name: self._hold(each, memo) for name, each in attributes(value).items()})
        memo[id(value)] = held, value  # the value, so that its id stays its own
        return held


def _live(value: Any) -> Any:
    """Attributes of an object: its dictionary, or the object itself when it has slots."""
    return value if _slots(type(value)) else vars(value)


def _contents(value: Any) -> Any:
    """Attributes or items of a mutable object."""
    return value if isinstance(value, _CONTAINERS) else attributes(value)


def owner(array: NDArray[Any]) -> NDArray[Any]:
    """The array that owns the memory of another one."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


def is_ours(value: object) -> bool:
    """Whether an object is of this project, and neither the robot nor a node."""
    module = type(value).__module__
    ours = module.split(".", 1)[0] in PACKAGES and ".nodes" not in module
    return ours and not isinstance(value, (*_LEFT, Enum))


def is_frozen(value: object) -> bool:
    """Whether the attributes of an object cannot change."""
    if isinstance(value, Struct):
        return value.__struct_config__.frozen
    parameters = getattr(type(value), "__dataclass_params__", None)
    return parameters is not None and bool(parameters.frozen)


def attributes(value: object) -> dict[str, Any]:
    """Attributes of an object by name, those of slots included."""
    own = getattr(value, "__dict__", None)
    names = _slots(type(value))
    if not names:
        return own if own is not None else {}
    found = {name: getattr(value, name) for name in names if hasattr(value, name)}
    return found if own is None else found | own


_SLOTS: dict[type, tuple[str, ...]] = {}


def _slots(kind: type) -> tuple[str, ...]:
    """Names of the slots of a class and those it comes from."""
    if kind not in _SLOTS:
        each = [vars(one).get("__slots__", ()) for one in kind.__mro__]
        names = [name for slots in each for name in ((slots,) if isinstance(slots, str) else slots)]
        _SLOTS[kind] = tuple(name for name in names if name not in ("__dict__", "__weakref__"))
    return _SLOTS[kind]
