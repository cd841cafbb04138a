"""Bytes of ``unitree_hg``'s LowState and LowCmd: XCDR1 on the wire, the C structure under the checksum.

A message is a NumPy record of the C structure, without an object for each of its 35 motors. XCDR1 aligns each member to
its size only, the C structure each structure to 4 bytes: they differ before the first motor and in padding.

The checksum is CRC-32/MPEG-2 over the little-endian words of the C structure, most significant bit first, without the
last word, which holds it. It is computed with ``zlib``, whose CRC-32 has the same polynomial on reflected bits:
crc(words) = reflect(~zlib.crc32(reflect(words))).
"""

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import MessageError

MOTORS = 35  #: Motors of a message, whatever the robot has
REMOTE_SIZE = 40  #: Bytes of the remote controller in LowState
ENCAPSULATION = b"\x00\x01\x00\x00"  #: Header of a serialised message: XCDR1, little-endian

#: Members of a LowState after the mode of the first motor, from which on both layouts are the same
_MOTOR_STATE: list[tuple[Any, ...]] = [
    ("q", "<f4"), ("dq", "<f4"), ("ddq", "<f4"), ("tau_est", "<f4"), ("temperature", "<i2", 2), ("vol", "<f4"),
    ("sensor", "<u4", 2), ("motorstate", "<u4"), ("reserve", "<u4", 4),
]  # fmt: skip
_MOTOR_CMD = np.dtype([
    ("mode", "u1"), ("pad", "u1", 3), ("q", "<f4"), ("dq", "<f4"), ("tau", "<f4"), ("kp", "<f4"), ("kd", "<f4"),
    ("reserve", "<u4"),
])  # fmt: skip
#: LowCmd as the C structure
LOW_CMD = np.dtype([
    ("mode_pr", "u1"), ("mode_machine", "u1"), ("pad", "u1", 2), ("motor_cmd", _MOTOR_CMD, MOTORS),
    ("reserve", "<u4", 4), ("crc", "<u4"),
])  # fmt: skip
_MOTOR_STATE_C = np.dtype([("mode", "u1"), ("pad", "u1", 3), *_MOTOR_STATE])
#: LowState as the C structure
LOW_STATE = np.dtype([
    ("version", "<u4", 2), ("mode_pr", "u1"), ("mode_machine", "u1"), ("pad", "u1", 2), ("tick", "<u4"),
    ("quaternion", "<f4", 4), ("gyroscope", "<f4", 3), ("accelerometer", "<f4", 3), ("rpy", "<f4", 3),
    ("imu_temperature", "<i2"), ("imu_pad", "u1", 2),
    ("motor_state", _MOTOR_STATE_C, MOTORS),
    ("wireless_remote", "u1", REMOTE_SIZE), ("reserve", "<u4", 4), ("crc", "<u4"),
])  # fmt: skip
_REFLECTED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], dtype=np.uint8)  #: Bits of a byte reversed


def checksum(structure: bytes | NDArray[np.uint8]) -> int:
    """CRC-32/MPEG-2 of a C structure (size,) over its words, without the last one, which holds it."""
    data = np.frombuffer(structure, dtype=np.uint8)[:-4]
    words = _REFLECTED[data.reshape(-1, 4)[:, ::-1]]  # most significant byte first
    return int(f"{~zlib.crc32(words.tobytes()) & 0xFFFFFFFF:032b}"[::-1], 2)


class _Layout:
    """Where the first motor of a message lies in both layouts, and the padding of the C structure.

    ``wire`` is the offset of its ``mode`` in XCDR1, where one byte of padding follows; in the C structure it lies 2
    bytes later, with 3 bytes of padding. All after it is the same in both.
    """

    def __init__(self, structure: np.dtype[Any], motors: str, pads: list[int]) -> None:
        fields: Any = structure.fields
        motor, self.inside = fields[motors][0].base, int(fields[motors][1])
        self.wire = self.inside - 2
        each = self.inside + motor.itemsize * np.arange(MOTORS)[:, None]  # (MOTORS, 1)
        self.pads = np.concatenate([pads, (each + 1 + np.arange(3)).ravel()])
        self.size, self.total = structure.itemsize, structure.itemsize - 4 + len(ENCAPSULATION)

    def unpack(self, name: str, data: bytes) -> NDArray[np.uint8]:
        """The C structure of a serialised message, padding zero; ``MessageError`` for a wrong size or checksum."""
        if len(data) != self.total or data[:2] != ENCAPSULATION[:2]:
            raise MessageError(
                f"{name}: {len(data)} bytes, {self.total} in little-endian XCDR1 expected: no robot of unitree_hg?"
            )
        body = np.frombuffer(data, dtype=np.uint8)[len(ENCAPSULATION) :]
        structure = np.zeros(self.size, dtype=np.uint8)
        structure[: self.wire] = body[: self.wire]
        structure[self.inside] = body[self.wire]
        structure[self.inside + 4 :] = body[self.wire + 2 :]
        structure[self.pads] = 0  # arbitrary on the wire
        given, found = int.from_bytes(structure[-4:].tobytes(), "little"), checksum(structure)
        if given != found:
            raise MessageError(f"{name}: crc {given:#010x} instead of {found:#010x}")
        return structure

    def pack(self, record: Any) -> bytes:
        """The serialised message of a record, with its checksum."""
        structure = np.frombuffer(bytearray(record.tobytes()), dtype=np.uint8)
        structure[self.pads] = 0
        crc = checksum(structure).to_bytes(4, "little")
        raw = structure.tobytes()
        mode = raw[self.inside : self.inside + 1]
        return b"".join((ENCAPSULATION, raw[: self.wire], mode, b"\0", raw[self.inside + 4 : -4], crc))


_STATE = _Layout(LOW_STATE, "motor_state", [10, 11, 70, 71])
_COMMAND = _Layout(LOW_CMD, "motor_cmd", [2, 3])
LOW_STATE_SIZE, LOW_CMD_SIZE = _STATE.total, _COMMAND.total  #: Serialised messages [bytes]


def read_low_state(data: bytes) -> Any:
    """Record of dtype ``LOW_STATE`` from a serialised message; ``MessageError`` for a wrong size or checksum."""
    return _STATE.unpack("lowstate", data).view(LOW_STATE)[0]


def write_low_state(record: Any) -> bytes:
    """Serialise a record of dtype ``LOW_STATE``, with its checksum; for the robot's side of tests."""
    return _STATE.pack(record)


def new_low_cmd() -> Any:
    """An empty record of dtype ``LOW_CMD``, for ``write_low_cmd``."""
    return np.zeros(1, dtype=LOW_CMD)[0]


def write_low_cmd(record: Any) -> bytes:
    """Serialise a record of dtype ``LOW_CMD``, with its checksum."""
    return _COMMAND.pack(record)


def read_low_cmd(data: bytes) -> Any:
    """Record of dtype ``LOW_CMD`` from a serialised message; ``MessageError`` for a wrong size or checksum."""
    return _COMMAND.unpack("lowcmd", data).view(LOW_CMD)[0]
