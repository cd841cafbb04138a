"""tf2_msgs/TFMessage as bytes: the transforms of one stamp between frames that do not change."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from models.nodes.cdr import NANOSECONDS, STAMP_OFFSET
from models.types import Vector

_HEADER = b"\x00\x01\x00\x00"
"""CDR, little endian."""

_WORD, _DOUBLE = 4, 8
"""Alignment of lengths and stamps, and of doubles, counted from behind the header [bytes]."""

POSE = 7
"""Numbers of a transform: translation (3), quaternion xyzw (4)."""


class TransformsCodec:
    """Writes stamps and poses into the bytes of a TFMessage that is laid out once.

    Args:
        frames: Parent and child of each transform, in the order in which ``encode`` takes the poses.
    """

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        data = bytearray(_HEADER + struct.pack("<I", len(frames)))
        self._stamps, poses = [], []
        for names in frames:
            _align(data, _WORD)
            self._stamps.append(len(data))
            data += bytes(_DOUBLE)
            for name in names:
                text = name.encode() + b"\x00"
                _align(data, _WORD)
                data += struct.pack("<I", len(text)) + text
            _align(data, _DOUBLE)
            poses.append(len(data))
            data += bytes(_DOUBLE * POSE)
        self._buffer = data
        self._views = [np.frombuffer(data, "<f8", POSE, offset) for offset in poses]

    def encode(self, stamp: int, poses: Sequence[Vector]) -> bytes:
        """Serialised message.

        Args:
            stamp: Of all transforms [ns].
            poses: Child in parent, one for each: translation [m], quaternion xyzw (7,).

        Returns:
            Bytes for ``Publisher.publish``.
        """
        time = divmod(stamp, NANOSECONDS)
        for offset, view, pose in zip(self._stamps, self._views, poses, strict=True):
            struct.pack_into("<iI", self._buffer, offset, *time)
            view[:] = pose
        return bytes(self._buffer)


def _align(data: bytearray, size: int) -> None:
    """Pad to a multiple of ``size``, counted from behind the header."""
    data += bytes((STAMP_OFFSET - len(data)) % size)
