"""Messages of constant layout, serialised once and patched in place; makes 1 kHz over rclpy affordable.

A message with constant strings and array lengths has a constant CDR layout; only the stamp and the doubles change.
``Template`` serialises it once with a distinct marker in every slot and locates the markers. It packs by writing the
numbers into the bytes, and unpacks by reading them after a comparison of all other bytes. If these differ (joint order,
unknown name, size), ``unpack`` returns None and the caller decodes the whole message.
"""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from models.constants import NANOSECONDS as NANOSECONDS
from models.errors import MessageError
from models.types import Vector

#: Offset of ``header.stamp`` in every stamped message: right after the CDR encapsulation header [bytes]
STAMP_OFFSET = 4
STAMP_SIZE = 8  #: Seconds (int32) and nanoseconds (uint32) [bytes]


def field_of(message: Any, path: str) -> Any:
    """Field of a message by path, such as ``header.frame_id`` or ``points.0.effort``."""
    for part in path.split("."):
        message = message[int(part)] if part.isdigit() else getattr(message, part)
    return message


def numbers_of(value: Any) -> Vector:
    """Numbers of a field (n,): an array, or a message of numbers, such as a Pose, in the order of its definition."""
    if hasattr(value, "get_fields_and_field_types"):
        return np.concatenate([numbers_of(getattr(value, name)) for name in value.get_fields_and_field_types()])
    return np.array(value, dtype=np.float64, ndmin=1)


def _fill(message: Any, path: str, markers: list[float]) -> None:
    """Replace the numbers of a field by the first markers, and remove these from the list."""
    value = field_of(message, path)
    if hasattr(value, "get_fields_and_field_types"):
        for name in value.get_fields_and_field_types():
            _fill(value, name, markers)
    else:
        count = numbers_of(value).size
        parent, _, name = path.rpartition(".")
        owner = field_of(message, parent) if parent else message
        setattr(owner, name, markers[:count] if np.ndim(value) else markers[0])
        del markers[:count]


class Template:
    """Layout of one stamped message with constant strings and sizes.

    ``fields`` are the paths of the slots, in the order of the values of ``pack``; see ``field_of``. Raises
    ``MessageError`` if the numbers of a field are not contiguous in the bytes.
    """

    def __init__(self, message: Any, fields: Sequence[str]) -> None:
        sizes = [numbers_of(field_of(message, path)).size for path in fields]
        markers = np.split(-7.25e301 - 1e290 * np.arange(1, sum(sizes) + 1), np.cumsum(sizes)[:-1])
        for path, values in zip(fields, markers, strict=True):
            _fill(message, path, values.tolist())
        data = bytes(serialize_message(message))
        offsets = [data.find(values.astype("<f8").tobytes()) for values in markers]
        if min(offsets) < 0:
            raise MessageError(f"{type(message).__name__}: the numbers of {fields} are not contiguous")
        self.size, self._marked, self._message = len(data), data, message
        self._slots = list(zip(offsets, sizes, strict=True))
        changing = [(STAMP_OFFSET, STAMP_SIZE), *sorted((offset, 8 * size) for offset, size in self._slots)]
        self._changing = [slice(start, start + size) for start, size in changing]
        starts, stops = (
            [0, *(each.stop for each in self._changing)],
            [*(each.start for each in self._changing), len(data)],
        )
        self._gaps = [slice(start, stop) for start, stop in zip(starts, stops, strict=True)]
        self._seen = [data[gap] for gap in self._gaps]
        self._buffer = bytearray(data)
        self._views = [np.frombuffer(self._buffer, "<f8", size, offset) for offset, size in self._slots]

    def pack(self, stamp_ns: int, values: Sequence[Vector]) -> bytes:
        """Serialised message from a stamp [ns] and one array per slot."""
        struct.pack_into("<iI", self._buffer, STAMP_OFFSET, *divmod(stamp_ns, NANOSECONDS))
        for view, value in zip(self._views, values, strict=True):
            view[:] = value
        return bytes(self._buffer)

    def matches(self, data: bytes) -> bool:
        """Whether the constant part is equal; decodes the message if its bytes differ from the last match."""
        if len(data) != self.size:
            return False
        found = [data[gap] for gap in self._gaps]
        if found == self._seen:
            return True
        marked = bytearray(data)
        for part in self._changing:
            marked[part] = self._marked[part]
        try:
            same = bool(deserialize_message(bytes(marked), type(self._message)) == self._message)
        except Exception:  # rclpy raises RuntimeError and RCLError, by version
            return False
        if same:
            self._seen = found
        return same

    def unpack(self, data: bytes) -> list[Vector] | None:
        """Copies of the slots of a serialised message; None if the layout or the constant part differs."""
        if not self.matches(data):
            return None
        return [np.frombuffer(data, "<f8", size, offset).copy() for offset, size in self._slots]


def stamp_of(data: bytes, *, logged: bool = False) -> int:
    """Value of ``header.stamp`` in serialised bytes [ns].

    Raises ``MessageError`` for too few bytes or, unless ``logged``, for negative seconds or nanoseconds >= 1e9.
    """
    if len(data) < STAMP_OFFSET + STAMP_SIZE:
        raise MessageError(f"header.stamp: message of {len(data)} bytes is too short")
    sec, nanosec = struct.unpack_from("<iI", data, STAMP_OFFSET)
    if not logged and (sec < 0 or nanosec >= NANOSECONDS):
        raise MessageError(f"header.stamp: {sec} s and {nanosec} ns, expected at least 0 s and less than 1e9 ns")
    return int(sec) * NANOSECONDS + int(nanosec)
