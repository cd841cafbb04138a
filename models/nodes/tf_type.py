"""tf2_msgs/TFMessage: the installed or built message, or where there is none a type support made without a compiler.

The wheels of ROS 2 carry the generators of messages but not ``tf2_msgs``, and what the generators write needs a
compiler and Python's headers (``models/nodes/interface_build.py``), which a fresh machine may lack. Publishing
serialised bytes needs much less than a message class: the middleware asks a type support only for the name, the hash
and the description of the type, and whether its size is bounded. All of that follows from
``geometry_msgs/TransformStamped``, whose type support is at hand: the C structures are filled here with ctypes, from
the donor's own.

Their layout is not taken on trust: before anything is built, the donor is read back through the same structures, and
its names and its hash have to come out right. ``ros2 topic echo /tf`` and every tf listener see an ordinary TFMessage.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
from ctypes import addressof, c_char_p, c_size_t, c_uint8, c_void_p
from functools import cache
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.utilities import get_rmw_implementation_identifier

from models.errors import MessageError
from models.nodes import type_support as c
from models.nodes.interfaces import interface

TYPE_NAME = "tf2_msgs/msg/TFMessage"

DEFINITION = "geometry_msgs/TransformStamped[] transforms\n"
"""Text of TFMessage.msg."""

_DONOR_NAME = b"geometry_msgs/msg/TransformStamped"

_SEQUENCE_OF_MESSAGES = 145
"""Field type of an unbounded sequence of another message (type_description_interfaces/FieldType)."""

_MESSAGE = 18
"""Type of a member that is a message (rosidl_typesupport_introspection_c/field_types.h)."""

_FAST_DDS, _INTROSPECTION = b"rosidl_typesupport_fastrtps_c", b"rosidl_typesupport_introspection_c"

_SUPPORTED_RMW = "rmw_fastrtps_cpp"


@cache
def tf_message_type() -> Any:
    """Type to publish and subscribe serialised TFMessages with.

    Raises:
        MessageError: There is no ``tf2_msgs`` and none can be made for this ROS 2; says why.
    """
    try:
        return interface("tf2_msgs", "msg", "TFMessage")
    except MessageError:
        return made_message_type()


@cache
def made_message_type() -> Any:
    """The type as it is made where ``tf2_msgs`` is not installed; for serialised messages only.

    Raises:
        MessageError: This ROS 2 is not laid out as expected; says where.
    """
    rmw = get_rmw_implementation_identifier()
    if rmw != _SUPPORTED_RMW:
        raise MessageError(f"tf2_msgs is not installed, and it is made for {_SUPPORTED_RMW} only, not for {rmw}")
    return _message_class(_TypeSupport())


class _TypeSupport:
    """Owns every structure that the middleware is given addresses of.

    Attributes:
        capsule: The type support as rclpy takes it.
    """

    def __init__(self) -> None:
        donor, self._members = _donor(_FAST_DDS), _donor(_INTROSPECTION)
        self._describe(donor)
        self._implementations = {
            _FAST_DDS: self._support(_FAST_DDS, self._callbacks(donor)),
            _INTROSPECTION: self._support(_INTROSPECTION, self._introspection()),
        }
        self._top = self._support(_FAST_DDS, c_void_p())
        self.capsule = _pythonapi("PyCapsule_New", ctypes.py_object, c_void_p, c_char_p, c_void_p)(
            addressof(self._top), None, None
        )

    def _support(self, identifier: bytes, data: Any) -> c.Support:
        """One type support; all of them lead to the same implementations, hash and description."""
        pointers = (self._hash, self._description, self._sources)
        gives = [_giver(addressof(each)) for each in pointers]
        support = c.Support(identifier, addressof(data), c.Find(self._find), *gives)
        support.kept = data
        return support

    def _find(self, _: int, identifier: bytes) -> int | None:
        found = self._implementations.get(identifier)
        return None if found is None else addressof(found)

    def _callbacks(self, donor: c.Support) -> c.Callbacks:
        """For Fast DDS: the name, and the donor's answer that the size has no bound."""
        known = c.Callbacks.from_address(donor.data)
        _require((known.namespace, known.name) == (b"geometry_msgs::msg", b"TransformStamped"))
        return c.Callbacks(b"tf2_msgs::msg", b"TFMessage", max_serialized_size=known.max_serialized_size)

    def _introspection(self) -> c.Members:
        """For the type object that Fast DDS announces: one member, a sequence of the donor."""
        known = c.Members.from_address(self._members.data)
        _require((known.namespace, known.name, known.count) == (b"geometry_msgs__msg", b"TransformStamped", 3))
        _require([known.members[i].name for i in range(3)] == [b"header", b"child_frame_id", b"transform"])
        member = c.Member(b"transforms", _MESSAGE, 0, addressof(self._members), is_array=True)
        sequence = 3 * ctypes.sizeof(c_size_t)  # data, size, capacity
        return c.Members(b"tf2_msgs__msg", b"TFMessage", 1, sequence, members=ctypes.pointer(member))

    def _describe(self, donor: c.Support) -> None:
        """Hash, description and text of TFMessage and of everything it consists of."""
        known = c.Description.from_address(donor.description(None))
        field = c.Field(_string("transforms"), _SEQUENCE_OF_MESSAGES, nested_type_name=known.type.type_name)
        types = [known.type, *known.referenced.data[: known.referenced.size]]
        types.sort(key=lambda each: bytes(each.type_name.data))
        self._description = c.Description(
            c.Type(_string(TYPE_NAME), c.Fields(ctypes.pointer(field), 1, 1)),
            c.Types((c.Type * len(types))(*types), len(types), len(types)),
        )
        texts = c.Sources.from_address(donor.sources(None))
        own = c.Source(_string(TYPE_NAME), _string("msg"), _string(DEFINITION))
        count = texts.size + 1
        self._sources = c.Sources((c.Source * count)(own, *texts.data[: texts.size]), count, count)
        self._hash = c.Hash(1, (c_uint8 * 32)(*type_hash(self._description)))


def _giver(address: int) -> Any:
    """C function that returns an address."""
    return c.Give(lambda _: address)


def _donor(identifier: bytes) -> c.Support:
    """Type support of TransformStamped, checked against what it must say."""
    meta = type(TransformStamped)
    if meta._TYPE_SUPPORT is None:
        meta.__import_type_support__()
    name = _pythonapi("PyCapsule_GetName", c_char_p, ctypes.py_object)(meta._TYPE_SUPPORT)
    address = _pythonapi("PyCapsule_GetPointer", c_void_p, ctypes.py_object, c_char_p)(meta._TYPE_SUPPORT, name)
    found = c.Support.from_address(address).find(address, identifier)
    _require(found)
    support = c.Support.from_address(found)
    _require(support.identifier == identifier)
    description = c.Description.from_address(support.description(found))
    _require(description.type.type_name.data == _DONOR_NAME)
    digest = c.Hash.from_address(support.hash(found))
    _require((digest.version, bytes(digest.value)) == (1, type_hash(description)))
    return support


def _require(right: object) -> None:
    if not right:
        raise MessageError("tf2_msgs is not installed, and this ROS 2 lays out its types in an unknown way")


def _pythonapi(name: str, result: Any, *arguments: Any) -> Any:
    """Function of Python's C API, apart from other users' declarations of it."""
    return ctypes.PYFUNCTYPE(result, *arguments)((name, ctypes.pythonapi))


def _string(text: str) -> c.String:
    data = text.encode()
    return c.String(data, len(data), len(data) + 1)


def type_hash(description: c.Description) -> bytes:
    """SHA-256 of a type as REP-2011 defines it: of the description as JSON, without default values (32,)."""
    described = {
        "type_description": _plain(description.type),
        "referenced_type_descriptions": [
            _plain(each) for each in description.referenced.data[: description.referenced.size]
        ],
    }
    return hashlib.sha256(json.dumps(described).encode()).digest()


def _plain(description: c.Type) -> dict[str, object]:
    return {
        "type_name": description.type_name.data.decode(),
        "fields": [
            {
                "name": field.name.data.decode(),
                "type": {
                    "type_id": field.type_id,
                    "capacity": field.array_capacity,
                    "string_capacity": field.string_capacity,
                    "nested_type_name": (field.nested_type_name.data or b"").decode(),
                },
            }
            for field in description.fields.data[: description.fields.size]
        ],
    }


def _message_class(support: _TypeSupport) -> Any:
    """What rclpy takes for a message class; no instance can be made, because none could be converted."""

    class Metaclass(type):
        _TYPE_SUPPORT = support.capsule
        _CREATE_ROS_MESSAGE = _CONVERT_FROM_PY = _CONVERT_TO_PY = _DESTROY_ROS_MESSAGE = "bytes only"

    class TFMessage(metaclass=Metaclass):
        """tf2_msgs/TFMessage, serialised."""

        type_support = support

        def __init__(self) -> None:
            raise TypeError("tf2_msgs is not installed: TFMessage is published and received as bytes only")

    return TFMessage
