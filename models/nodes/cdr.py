"""Messages of constant layout, serialised once and patched in place: what makes 1 kHz over rclpy affordable.

A ROS message whose strings and array lengths do not change has a constant CDR layout: only the stamp and the doubles
differ from one message to the next. ``Template`` serialises the message once with a different marker in every slot,
finds the markers, and from then on packs by writing the numbers into the bytes and unpacks by reading them, after it
has compared everything else with the template. Where anything else differs (another joint order, an unknown name,
another size), ``unpack`` returns None and the caller decodes the message in full and judges it.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from models.errors import MessageError
from models.types import Vector

STAMP_OFFSET = 4
"""Offset of ``header.stamp`` in every stamped message: right after the CDR encapsulation header [bytes]."""

STAMP_SIZE = 8
"""Seconds (int32) and nanoseconds (uint32) [bytes]."""

NANOSECONDS = 1_000_000_000


class Markers:
    """Distinct doubles to fill a message with, so that its slots can be found in the serialised bytes."""

    def __init__(self) -> None:
        self._next = 1

    def take(self, size: int) -> Vector:
        """Fresh markers (size,); none occurs twice."""
        values = -7.25e301 - 1e290 * np.arange(self._next, self._next + size, dtype=np.float64)
        self._next += size
        return values


class Template:
    """Layout of one stamped message whose strings and sizes do not change.

    Args:
        message: Message filled with markers, for example from ``Markers.take``.
        slots: The marker arrays, each contiguous in the message, in the order in which ``pack`` takes the values.

    Raises:
        MessageError: A marker is not found: the message cannot be handled this way.
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
        self._buffer = bytearray(data)
        self._slots = [(offset, slot.size) for offset, slot in zip(offsets, slots, strict=True)]
        self._views = [np.frombuffer(self._buffer, "<f8", size, offset) for offset, size in self._slots]
        self._constant = self._constant_parts(data)

    def _constant_parts(self, data: bytes) -> list[tuple[int, int, bytes]]:
        """Every stretch between the stamp and the slots, as (start, end, bytes); the encapsulation header first."""
        parts = [(0, STAMP_OFFSET, data[:STAMP_OFFSET])]
        start = STAMP_OFFSET + STAMP_SIZE
        for offset, size in sorted(self._slots):
            parts.append((start, offset, data[start:offset]))
            start = offset + 8 * size
        parts.append((start, len(data), data[start:]))
        return [part for part in parts if part[0] < part[1]]

    def pack(self, stamp_ns: int, values: Sequence[Vector]) -> bytes:
        """Serialised message.

        Args:
            stamp_ns: Value of ``header.stamp`` [ns].
            values: One array for each slot, of the slot's size.

        Returns:
            Bytes for ``Publisher.publish``.
        """
        struct.pack_into("<iI", self._buffer, STAMP_OFFSET, *divmod(stamp_ns, NANOSECONDS))
        for view, value in zip(self._views, values, strict=True):
            view[:] = value
        return bytes(self._buffer)

    def matches(self, data: bytes) -> bool:
        """Whether everything but the stamp and the slots equals the template."""
        if len(data) != self.size:
            return False
        return all(data[start:end] == part for start, end, part in self._constant)

    def unpack(self, data: bytes) -> list[Vector] | None:
        """Values of the slots, as copies that nobody else writes to.

        Args:
            data: Serialised message, as a raw subscription delivers it.

        Returns:
            One array for each slot, or None when the layout or the constant part differs.
        """
        if not self.matches(data):
            return None
        return [np.frombuffer(data, "<f8", size, offset).copy() for offset, size in self._slots]


def stamp_of(data: bytes) -> int:
    """Value of ``header.stamp`` in serialised bytes [ns].

    Raises:
        MessageError: Fewer bytes than a stamp needs.
    """
    if len(data) < STAMP_OFFSET + STAMP_SIZE:
        raise MessageError(f"header.stamp: message of {len(data)} bytes is too short")
    sec, nanosec = struct.unpack_from("<iI", data, STAMP_OFFSET)
    return int(sec) * NANOSECONDS + int(nanosec)
