"""Messages of constant layout, serialised once and patched in place: makes 1 kHz over rclpy affordable.

A message whose strings and array lengths are constant has a constant CDR layout; only the stamp and the doubles change.
``Template`` serialises it once with a distinct marker in every slot and finds the markers. It then packs by writing the
numbers into the bytes and unpacks by reading them, after comparing all other bytes. Where these differ (joint order,
unknown name, size), ``unpack`` returns None and the caller decodes the whole message.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import serialize_message

from models.constants import NANOSECONDS as NANOSECONDS
from models.errors import MessageError
from models.types import Vector

#: Offset of ``header.stamp`` in every stamped message: right after the CDR encapsulation header [bytes]
STAMP_OFFSET = 4
STAMP_SIZE = 8  #: Seconds (int32) and nanoseconds (uint32) [bytes]


class Markers:
    """Distinct doubles that locate the slots of a message in its serialised bytes."""

    def __init__(self) -> None:
        self._next = 1

    def take(self, size: int) -> Vector:
        """Fresh markers (size,); none occurs twice."""
        values = -7.25e301 - 1e290 * np.arange(self._next, self._next + size, dtype=np.float64)
        self._next += size
        return values


def padding(message: Any, size: int) -> NDArray[np.bool_]:
    """Padding of a serialised message, whose value the serialiser leaves undefined, as flags (size,).

    Raises ``MessageError`` when a field has an unsupported type or the layout does not add up to ``size``.
    """
    free = np.zeros(size, dtype=np.bool_)
    end = _walk(message, "", STAMP_OFFSET, free)
    if not 0 <= size - end <= _SPARE:  # the serialiser reserves for the worst alignment
        raise MessageError(f"{type(message).__name__}: {end} bytes laid out, {size} serialised")
    free[end:] = True
    return free


_WORD = 4  #: Size and alignment of lengths [bytes]
_SPARE = 16  #: Most bytes that a serialised message may have behind its end [bytes]
_SIZES = {"double": 8, "int32": 4, "uint32": 4}  #: Size and alignment of the primitive types that occur [bytes]


def _walk(value: Any, kind: str, at: int, free: NDArray[np.bool_]) -> int:
    """Lay out one value of a ROS type at an offset and mark its padding; returns the offset behind it."""
    if hasattr(value, "get_fields_and_field_types"):
        for name, field in value.get_fields_and_field_types().items():
            at = _walk(getattr(value, name), field, at, free)
        return at
    if kind == "string":
        return _align(at, _WORD, free) + _WORD + len(value.encode()) + 1
    if kind in _SIZES:
        return _align(at, _SIZES[kind], free) + _SIZES[kind]
    if kind.startswith("sequence<"):
        item = kind[len("sequence<") : -1]
        at = _align(at, _WORD, free) + _WORD
    elif kind.endswith("]"):
        item = kind[: kind.index("[")]
    else:
        raise MessageError(f"type '{kind}' has no constant layout that is known here")
    for element in value:
        at = _walk(element, item, at, free)
    return at


def _align(at: int, size: int, free: NDArray[np.bool_]) -> int:
    """Next multiple of ``size``, counted from behind the encapsulation header; marks the skipped bytes as padding."""
    aligned = at + (STAMP_OFFSET - at) % size
    free[at:aligned] = True
    return aligned


class Template:
    """Layout of one stamped message whose strings and sizes do not change.

    Args:
        message: Message filled with markers, for example from ``Markers.take``.
        slots: The marker arrays, each contiguous in the message, in the order in which ``pack`` takes the values.

    Raises:
        MessageError: A marker is not found in the bytes.
    """

    def __init__(self, message: Any, slots: Sequence[Vector]) -> None:
        data = bytes(serialize_message(message))
        offsets = []
        for slot in slots:
            offset = data.find(np.ascontiguousarray(slot, dtype="<f8").tobytes())
            if offset < 0:
                raise MessageError(f"{type(message).__name__}: a block of {slot.size} numbers is not contiguous")
            offsets.append(offset)
        self.size = len(data)
        self._slots = [(offset, slot.size) for offset, slot in zip(offsets, slots, strict=True)]
        free = padding(message, self.size)
        for start, size in [(STAMP_OFFSET, STAMP_SIZE), *((offset, 8 * size) for offset, size in self._slots)]:
            free[start : start + size] = True
        self._mask = np.where(free, 0, 255).astype(np.uint8)
        constant = np.frombuffer(data, np.uint8) & self._mask
        self._constant = constant.tobytes()
        self._masked = np.empty_like(self._mask)
        ends = [(STAMP_OFFSET, STAMP_OFFSET + STAMP_SIZE)]
        ends += sorted((offset, offset + 8 * size) for offset, size in self._slots)
        starts, stops = [0, *(stop for _, stop in ends)], [*(start for start, _ in ends), self.size]
        self._gaps = [slice(start, stop) for start, stop in zip(starts, stops, strict=True)]
        self._seen = [self._constant[gap] for gap in self._gaps]
        self._buffer = bytearray(self._constant)
        self._views = [np.frombuffer(self._buffer, "<f8", size, offset) for offset, size in self._slots]

    def pack(self, stamp_ns: int, values: Sequence[Vector]) -> bytes:
        """Serialised message of a stamp [ns] and one array for each slot."""
        struct.pack_into("<iI", self._buffer, STAMP_OFFSET, *divmod(stamp_ns, NANOSECONDS))
        for view, value in zip(self._views, values, strict=True):
            view[:] = value
        return bytes(self._buffer)

    def matches(self, data: bytes) -> bool:
        """Whether everything but the stamp, the slots and the padding equals the template."""
        if len(data) != self.size:
            return False
        found = [data[gap] for gap in self._gaps]
        if found == self._seen:  # like the last one that matched, padding included: a sender mostly repeats itself
            return True
        np.bitwise_and(np.frombuffer(data, np.uint8), self._mask, out=self._masked)
        if self._masked.tobytes() != self._constant:
            return False
        self._seen = found
        return True

    def unpack(self, data: bytes) -> list[Vector] | None:
        """Copies of the slots of a serialised message; None when the layout or the constant part differs."""
        if not self.matches(data):
            return None
        return [np.frombuffer(data, "<f8", size, offset).copy() for offset, size in self._slots]


def stamp_of(data: bytes) -> int:
    """Value of ``header.stamp`` in serialised bytes [ns]; ``MessageError`` when they are too short."""
    if len(data) < STAMP_OFFSET + STAMP_SIZE:
        raise MessageError(f"header.stamp: message of {len(data)} bytes is too short")
    sec, nanosec = struct.unpack_from("<iI", data, STAMP_OFFSET)
    return int(sec) * NANOSECONDS + int(nanosec)
