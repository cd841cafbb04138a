"""C structures of a message's type support in ROS 2 Jazzy (``rosidl_runtime_c`` and its type supports), for ctypes."""

from __future__ import annotations

from ctypes import CFUNCTYPE, POINTER, Structure, c_bool, c_char_p, c_size_t, c_uint8, c_uint32, c_uint64, c_void_p


class String(Structure):
    """``rosidl_runtime_c__String``."""

    _fields_ = (("data", c_char_p), ("size", c_size_t), ("capacity", c_size_t))


class Field(Structure):
    """``Field`` with its ``FieldType`` inside."""

    _fields_ = (
        ("name", String),
        ("type_id", c_uint8),
        ("array_capacity", c_uint64),
        ("string_capacity", c_uint64),
        ("nested_type_name", String),
        ("default_value", String),
    )


class Fields(Structure):
    """``rosidl_runtime_c__type_description__Field__Sequence``."""

    _fields_ = (("data", POINTER(Field)), ("size", c_size_t), ("capacity", c_size_t))


class Type(Structure):
    """``IndividualTypeDescription``."""

    _fields_ = (("type_name", String), ("fields", Fields))


class Types(Structure):
    """``rosidl_runtime_c__type_description__IndividualTypeDescription__Sequence``."""

    _fields_ = (("data", POINTER(Type)), ("size", c_size_t), ("capacity", c_size_t))


class Description(Structure):
    """``TypeDescription``."""

    _fields_ = (("type", Type), ("referenced", Types))


class Source(Structure):
    """``TypeSource``."""

    _fields_ = (("type_name", String), ("encoding", String), ("contents", String))


class Sources(Structure):
    """``rosidl_runtime_c__type_description__TypeSource__Sequence``."""

    _fields_ = (("data", POINTER(Source)), ("size", c_size_t), ("capacity", c_size_t))


class Hash(Structure):
    """``rosidl_type_hash_t``."""

    _fields_ = (("version", c_uint8), ("value", c_uint8 * 32))


class Callbacks(Structure):
    """``message_type_support_callbacks_t``; only ``max_serialized_size`` is called for serialised messages."""

    _fields_ = (
        ("namespace", c_char_p),
        ("name", c_char_p),
        ("serialize", c_void_p),
        ("deserialize", c_void_p),
        ("serialized_size", c_void_p),
        ("max_serialized_size", c_void_p),
        ("key_callbacks", c_void_p),
    )


Give = CFUNCTYPE(c_void_p, c_void_p)
Find = CFUNCTYPE(c_void_p, c_void_p, c_char_p)


class Support(Structure):
    """``rosidl_message_type_support_t``."""

    _fields_ = (
        ("identifier", c_char_p),
        ("data", c_void_p),
        ("find", Find),
        ("hash", Give),
        ("description", Give),
        ("sources", Give),
    )


class Member(Structure):
    """``rosidl_typesupport_introspection_c__MessageMember``; the accessors are for messages that are no bytes."""

    _fields_ = (
        ("name", c_char_p),
        ("type_id", c_uint8),
        ("string_upper_bound", c_size_t),
        ("members", c_void_p),
        ("is_key", c_bool),
        ("is_array", c_bool),
        ("array_size", c_size_t),
        ("is_upper_bound", c_bool),
        ("offset", c_uint32),
        ("default_value", c_void_p),
        ("accessors", c_void_p * 6),
    )


class Members(Structure):
    """``rosidl_typesupport_introspection_c__MessageMembers``."""

    _fields_ = (
        ("namespace", c_char_p),
        ("name", c_char_p),
        ("count", c_uint32),
        ("size", c_size_t),
        ("has_key", c_bool),
        ("members", POINTER(Member)),
        ("init", c_void_p),
        ("fini", c_void_p),
    )
