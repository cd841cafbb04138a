"""State of a law, copied within a tick and restored bit for bit in a law of the same construction.

A law keeps its state in arrays that compiled kernels write to, and in attributes. ``LawState`` searches a law once,
when it has just been built, for every array that owns memory and every object of this project that can change.
``capture`` then copies the arrays into preallocated memory and pickles the attributes that have changed. Objects that
existed at construction are stored by their path, later ones (a reference, a plan) by their content. The laws contain no
code for this, so a change of a law cannot omit state. Constants are excluded: the robot, configurations, objects of
other libraries. ``restore`` creates arrays and records of this project only, and never executes the stored content.
"""

import pickle
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum
from functools import cache
from importlib import import_module
from io import BytesIO
from operator import is_
from types import FunctionType, MethodType
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from models.errors import PoiseError
from models.robot_model import RobotModel
from models.trajectory import TrajectorySampler

PACKAGES = ("models", "planners", "controllers")  #: Packages whose objects are searched
_CONSTANTS = (RobotModel, type, FunctionType, MethodType)  #: Classes whose objects are not searched
#: Pickled by content without further checks
_ATOMS = frozenset({bool, int, float, str, bytes, type(None)})
_CONTAINERS = (list, dict, deque, set)  #: Containers that can change
#: Never changed after construction, therefore not copied: a copy takes long
_UNCHANGING = (TrajectorySampler,)
#: Kinds of objects that each tick recreates
_TRANSIENT = ("builtins:method", "builtins:function")
_OTHER_VERSION = "the state of the laws is of another version of poise, or of other libraries"
Bytes = NDArray[np.uint8]


@dataclass(slots=True)
class Captured:
    """Result of ``LawState.capture``."""

    memory: list[NDArray[Any]]  #: Contents of the arrays
    objects: bytes  #: Pickled contents of the changed objects by path
    later: list[Any]  #: Copies of new arrays, and unchanging objects; ``objects`` refers to them by index


class _Constant(NamedTuple):
    """Placeholder of a constant, which ``restore`` leaves unchanged."""

    kind: str


class LawState:
    """State of a newly built law, except the objects ``apart``: memory-owning ``arrays`` and mutable ``objects``."""

    def __init__(self, law: object, apart: Collection[object] = ()) -> None:
        self.arrays: dict[str, NDArray[Any]] = {}
        self.objects: dict[str, Any] = {}
        self.places: dict[int, str] = {}
        self.found: dict[str, Any] = {}
        self._apart = {id(each) for each in apart}
        self._find(law, "")
        self._initial = [_content(each).copy() for each in self.objects.values()]

    def _find(self, value: Any, place: str) -> None:
        if id(value) in self.places:
            return
        if isinstance(value, np.ndarray):
            self._find_array(value, place)
        elif isinstance(value, _CONTAINERS):
            self._register(value, place)
            self.objects[place] = value
            for key, each in value.items() if isinstance(value, dict) else enumerate(value):
                self._find(each, f"{place}[{key!r}]")
        elif isinstance(value, tuple):
            self._register(value, place)
            for i, each in enumerate(value):
                self._find(each, f"{place}[{i}]")
        elif self.is_searched(value):
            self._register(value, place)
            if not is_frozen(value):
                self.objects[place] = value
            for name, each in attributes(value).items():
                self._find(each, f"{place}.{name}")

    def _find_array(self, value: NDArray[Any], place: str) -> None:
        self._register(value, place)
        base = owner(value)
        if id(base) not in self.places:
            self._register(base, f"{place}^")
        if base.flags.writeable and self.places[id(base)] not in self.arrays:
            self.arrays[self.places[id(base)]] = base

    def _register(self, value: object, place: str) -> None:
        self.places[id(value)] = place
        self.found[place] = value  # the reference keeps the id valid

    def is_searched(self, value: Any) -> bool:
        """Whether an object belongs to this project and is neither a constant nor in ``apart``."""
        kind: Any = type(value)
        return is_searched_class(kind) and id(value) not in self._apart

    def memory(self) -> list[NDArray[Any]]:
        """Memory for ``capture``, written once so that ``capture`` causes no page faults."""
        return [each.copy() for each in self.arrays.values()]

    def capture(self, memory: list[NDArray[Any]]) -> Captured:
        """Copy the state; ``memory``, from ``memory()``, receives the arrays."""
        for copy, array in zip(memory, self.arrays.values(), strict=True):
            copy[...] = array
        changed: dict[str, Any] = {}
        for (place, each), built in zip(self.objects.items(), self._initial, strict=True):
            now = _content(each)
            if len(now) == len(built) and all(map(is_, _values(now), _values(built))):
                continue
            if isinstance(each, _CONTAINERS):
                changed[place] = tuple(now.items() if isinstance(now, dict) else now)
            else:
                changed[place] = tuple(pair for pair in now.items() if built.get(pair[0], built) is not pair[1])
        later: list[Any] = []
        return Captured(memory, self.pickled(changed, later), later)

    def pickled(self, value: Any, later: list[Any] | None = None) -> bytes:
        """Pickle a value with references to the objects of this law; ``later``, optional, receives large contents."""
        file = BytesIO()
        _Pickler(file, self, later).dump(value)
        return file.getvalue()


class _Pickler(pickle.Pickler):
    def __init__(self, file: BytesIO, law: LawState, later: list[Any] | None) -> None:
        super().__init__(file, protocol=5)
        self._law, self._later, self._numbers = law, later, dict[int, int]()

    def persistent_id(self, value: Any) -> Any:
        """Path of an object, part of an array at a path, index in ``later``, or kind; None to pickle the content."""
        kind = type(value)
        if kind in _ATOMS:
            return None
        if (place := self._law.places.get(id(value))) is not None:
            return place
        if kind is np.ndarray:
            base = owner(value)
            if (place := self._law.places.get(id(base))) is not None:
                return place, _address(value) - _address(base), value.dtype.str, value.shape, value.strides
        if self._later is not None and isinstance(value, (np.ndarray, *_UNCHANGING)):
            if id(value) not in self._numbers:
                self._numbers[id(value)] = len(self._later)
                self._later.append(value.copy() if isinstance(value, np.ndarray) else value)
            return self._numbers[id(value)]
        if (
            self._law.is_searched(value)
            or isinstance(value, _BY_CONTENT)
            or any(value is each for each in _CONSTRUCTORS)
        ):
            return None
        return (_name(kind),)

    def reducer_override(self, value: Any) -> Any:
        """Objects of this project by class and attributes."""
        if isinstance(value, Enum):
            return _make, (_name(type(value)), value.name)
        if hasattr(value, "_asdict") or self._law.is_searched(value):
            return _make, (_name(type(value)), attributes(value))
        return NotImplemented


class _Unpickler(pickle.Unpickler):
    def __init__(self, data: Bytes, law: LawState, later: list[Any]) -> None:
        super().__init__(BytesIO(data.tobytes()))
        self._law, self._later = law, later

    def persistent_load(self, pid: Any) -> Any:
        """See ``_Pickler.persistent_id``."""
        if isinstance(pid, str):
            return self._law.found[pid]
        if isinstance(pid, int):
            return self._later[pid]
        if len(pid) == 1:
            return _Constant(*pid)
        place, begin, kind, shape, strides = pid
        return np.ndarray(shape, np.dtype(kind), self._law.found[place], begin, strides)

    def find_class(self, module: str, name: str) -> Any:
        """Constructor of arrays or records; ``PoiseError`` for any other name."""
        if (maker := _MAKERS.get((module, name))) is None:
            raise PoiseError(f"the state of the laws holds '{module}:{name[:64]}', which is not allowed")
        return maker


def _make(name: str, content: Any) -> Any:
    """Create an object of this project from class name and attributes, or an enum member from its name."""
    module, _, path = name.partition(":")
    kind: Any = import_module(module) if module.split(".", 1)[0] in PACKAGES else None
    for part in path.split("."):
        kind = getattr(kind, part, None)
    if not isinstance(kind, type):
        raise PoiseError(f"the state of the laws holds '{name[:64]}', which is not a class of poise")
    if issubclass(kind, Enum):
        return kind[content]
    if issubclass(kind, Struct | tuple):
        return kind(**content)
    made = object.__new__(kind)
    for key, value in content.items():
        object.__setattr__(made, key, value)
    return made


_CONSTRUCTORS: tuple[Any, ...] = (
    *(np.zeros(1).__reduce_ex__(protocol)[0] for protocol in (2, 5)),
    np.float64().__reduce__()[0],
    *(np.ndarray, np.dtype, deque, set, _make),
)
#: Everything that unpickling may call: NumPy's functions for arrays and numbers, containers, objects of this project
_MAKERS = {(maker.__module__, maker.__qualname__): maker for maker in _CONSTRUCTORS}
#: Pickled by content, as are objects of this project
_BY_CONTENT = (tuple, *_CONTAINERS, Enum, np.ndarray, np.generic, np.dtype, pickle.PickleBuffer)


def describe(law: LawState, captured: Captured) -> tuple[Bytes, dict[str, Any]]:
    """Bytes and description of a captured state."""
    arrays = law.pickled((captured.memory, captured.later))
    data = np.frombuffer(captured.objects + arrays, np.uint8)
    return data, {"arrays": _arrays(law), "objects": len(captured.objects)}


def restore(law: LawState, data: Bytes, description: dict[str, Any]) -> None:
    """Restore a captured state in a law of the same construction; ``PoiseError`` for another version of the law."""
    if description["arrays"] != _arrays(law):
        raise PoiseError(_OTHER_VERSION)
    objects, arrays = np.split(data, [description["objects"]])
    try:
        memory, later = _Unpickler(arrays, law, []).load()
        changed = _Unpickler(objects, law, later).load()
        targets = [law.objects[place] for place in changed]
    except (pickle.UnpicklingError, EOFError, LookupError) as error:
        raise PoiseError(_OTHER_VERSION) from error
    for array, copy in zip(law.arrays.values(), memory, strict=True):
        array[...] = copy
    for target, contents in zip(targets, changed.values(), strict=True):
        _assign(target, contents)


def _assign(target: Any, contents: tuple[Any, ...]) -> None:
    if isinstance(target, _CONTAINERS) and not isinstance(target, dict):
        old = [*target, *[None] * len(contents)]
        items = [_resolve(*pair) for pair in zip(contents, old, strict=False)]
        target.clear()
        (target.update if isinstance(target, set) else target.extend)(items)
        return
    before = _content(target)
    pairs = {name: _resolve(each, before.get(name)) for name, each in contents}
    if isinstance(target, dict):
        target.clear()
        target.update(pairs)
    else:
        for name, each in pairs.items():
            object.__setattr__(target, name, each)


def _resolve(value: Any, old: Any) -> Any:
    """Restored value, or the current value of a constant."""
    if not isinstance(value, _Constant):
        return value
    if old is None and value.kind not in _TRANSIENT:
        raise PoiseError(f"the state of the laws holds '{value.kind[:64]}', which cannot be restored")
    return old


def _arrays(law: LawState) -> list[list[Any]]:
    return [[place, each.dtype.str, list(each.shape)] for place, each in law.arrays.items()]


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])


def _content(value: Any) -> Any:
    return value if isinstance(value, _CONTAINERS) else attributes(value)


def _values(content: Any) -> Any:
    return content.values() if isinstance(content, dict) else content


def owner(array: NDArray[Any]) -> NDArray[Any]:
    """Array that owns the memory of ``array``."""
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


@cache
def is_searched_class(kind: Any) -> bool:
    """Whether a class belongs to this project and is neither a constant, an enum nor part of a ROS node."""
    ours = kind.__module__.split(".", 1)[0] in PACKAGES and ".nodes" not in kind.__module__
    return ours and not issubclass(kind, (*_CONSTANTS, Enum))


def is_frozen(value: object) -> bool:
    """Whether the attributes of an object cannot change."""
    if isinstance(value, Struct):
        return value.__struct_config__.frozen
    parameters = getattr(type(value), "__dataclass_params__", None)
    return parameters is not None and bool(parameters.frozen)


def attributes(value: object) -> dict[str, Any]:
    """Attributes of an object by name, including slots, or fields of a named tuple."""
    if isinstance(value, tuple):
        return dict(zip(value._fields, value, strict=True))  # type: ignore[attr-defined]
    own = getattr(value, "__dict__", None)
    kind: Any = type(value)
    names = _slots(kind)
    if not names:
        return own if own is not None else {}
    found = {name: getattr(value, name) for name in names if hasattr(value, name)}
    return found if own is None else found | own


@cache
def _slots(kind: Any) -> tuple[str, ...]:
    each = [vars(base).get("__slots__", ()) for base in kind.__mro__]
    names = [name for slots in each for name in ((slots,) if isinstance(slots, str) else slots)]
    return tuple(name for name in names if name not in ("__dict__", "__weakref__"))
