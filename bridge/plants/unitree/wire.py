"""Bytes of ``unitree_hg``'s LowState and LowCmd: XCDR1 on the wire, the C structure for the checksum.

A message is a NumPy record of the C structure, without an object for each of its 35 motors. XCDR1 aligns each member to
its size; the C structure aligns each nested structure to 4 bytes. They differ before the first motor and in padding.

The checksum is CRC-32/MPEG-2 over the little-endian words of the C structure, most significant bit first, except the
last word, which contains the checksum. It is computed with ``zlib``, whose CRC-32 has the same polynomial on reflected
bits: crc(words) = reflect(~zlib.crc32(reflect(words))).
"""

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import MessageError

MOTORS = 35  #: Motors in a message, independent of the robot
REMOTE_SIZE = 40  #: Size of ``wireless_remote`` in LowState [bytes]
ENCAPSULATION = b"\x00\x01\x00\x00"  #: Header of a serialised message: XCDR1, little-endian

#: Members of a motor's state after ``mode``; from here in the first motor both layouts are the same
_MOTOR_STATE: list[tuple[Any, ...]] = [
    ("q", "<f4"), ("dq", "<f4"), ("ddq", "<f4"), ("tau_est", "<f4"), ("temperature", "<i2", 2), ("vol", "<f4"),
    ("sensor", "<u4", 2), ("motorstate", "<u4"), ("reserve", "<u4", 4),
]  # fmt: skip
_MOTOR_CMD = np.dtype([
    ("mode", "u1"), ("pad", "u1", 3), ("q", "<f4"), ("dq", "<f4"), ("tau", "<f4"), ("kp", "<f4"), ("kd", "<f4"),
    ("reserve", "<u4"),
])  # fmt: skip
#: LowCmd as the C structure
_LOW_CMD = np.dtype([
    ("mode_pr", "u1"), ("mode_machine", "u1"), ("pad", "u1", 2), ("motor_cmd", _MOTOR_CMD, MOTORS),
    ("reserve", "<u4", 4), ("crc", "<u4"),
])  # fmt: skip
_MOTOR_STATE_C = np.dtype([("mode", "u1"), ("pad", "u1", 3), *_MOTOR_STATE])
#: LowState as the C structure
_LOW_STATE = np.dtype([
    ("version", "<u4", 2), ("mode_pr", "u1"), ("mode_machine", "u1"), ("pad", "u1", 2), ("tick", "<u4"),
    ("quaternion", "<f4", 4), ("gyroscope", "<f4", 3), ("accelerometer", "<f4", 3), ("rpy", "<f4", 3),
    ("imu_temperature", "<i2"), ("imu_pad", "u1", 2),
    ("motor_state", _MOTOR_STATE_C, MOTORS),
    ("wireless_remote", "u1", REMOTE_SIZE), ("reserve", "<u4", 4), ("crc", "<u4"),
])  # fmt: skip
_REFLECTED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], dtype=np.uint8)  #: Bits reversed


def checksum(structure: bytes | NDArray[np.uint8]) -> int:
    """CRC-32/MPEG-2 over the words of a C structure (size,), except the last one, which contains the checksum."""
    data = np.frombuffer(structure, dtype=np.uint8)[:-4]
    words = _REFLECTED[data.reshape(-1, 4)[:, ::-1]]  # most significant byte first
    return int(f"{~zlib.crc32(words.tobytes()) & 0xFFFFFFFF:032b}"[::-1], 2)


class Layout:
    """Layout of a message: record of the C structure (``dtype``), and serialised message of ``size`` bytes.

    On the wire one byte of padding follows the ``mode`` of the first motor. In the C structure this ``mode`` is 2 bytes
    later and is followed by 3 bytes of padding. The rest is the same in both. ``pads`` are the offsets of the other
    padding bytes in the C structure.
    """

    def __init__(self, name: str, dtype: np.dtype[Any], motors: str, pads: list[int]) -> None:
        fields: Any = dtype.fields
        motor, self._inside = fields[motors][0].base, int(fields[motors][1])  # offsets of the first ``mode``
        self._wire = self._inside - 2
        each = self._inside + motor.itemsize * np.arange(MOTORS)[:, None]  # (MOTORS, 1)
        self._pads = np.concatenate([pads, (each + 1 + np.arange(3)).ravel()])
        self._name, self.dtype, self.size = name, dtype, dtype.itemsize - 4 + len(ENCAPSULATION)

    def new(self) -> Any:
        """An empty record."""
        return np.zeros(1, dtype=self.dtype)[0]

    def read(self, data: bytes) -> Any:
        """Record of a serialised message, with zero padding; ``MessageError`` for a wrong size or checksum."""
        if len(data) != self.size or data[:2] != ENCAPSULATION[:2]:
            raise MessageError(
                f"{self._name}: {len(data)} bytes, {self.size} in little-endian XCDR1 expected: no robot of unitree_hg?"
            )
        body = np.frombuffer(data, dtype=np.uint8)[len(ENCAPSULATION) :]
        structure = np.zeros(self.dtype.itemsize, dtype=np.uint8)
        structure[: self._wire] = body[: self._wire]
        structure[self._inside] = body[self._wire]
        structure[self._inside + 4 :] = body[self._wire + 2 :]
        structure[self._pads] = 0  # arbitrary on the wire
        given, found = int.from_bytes(structure[-4:].tobytes(), "little"), checksum(structure)
        if given != found:
            raise MessageError(f"{self._name}: crc {given:#010x} instead of {found:#010x}")
        return structure.view(self.dtype)[0]

    def write(self, record: Any) -> bytes:
        """Serialised message of a record, with its checksum."""
        structure = np.frombuffer(bytearray(record.tobytes()), dtype=np.uint8)
        structure[self._pads] = 0
        crc = checksum(structure).to_bytes(4, "little")
        raw = structure.tobytes()
        mode = raw[self._inside : self._inside + 1]
        return b"".join((ENCAPSULATION, raw[: self._wire], mode, b"\0", raw[self._inside + 4 : -4], crc))


LOW_STATE = Layout("lowstate", _LOW_STATE, "motor_state", [10, 11, 70, 71])
LOW_CMD = Layout("lowcmd", _LOW_CMD, "motor_cmd", [2, 3])
