"""Bytes of ``unitree_hg``'s LowState and LowCmd: XCDR1 on the wire, the C structure under the checksum.

Both layouts are NumPy records, so that a message is read and written without an object for each of its 35 motors. They
differ in padding: XCDR1 aligns each member to its own size only, the C structure aligns each structure to 4 bytes. The
checksum is CRC-32/MPEG-2 over the little-endian words of the C structure, most significant bit first, without the last
word, which holds the checksum. It is computed with ``zlib``, whose CRC-32 is the same polynomial on reflected bits:
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
#: LowCmd, which is the same in both layouts
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
#: Offset of the first motor's mode in XCDR1, two bytes before that of the C structure; all after it is four bytes apart
_MODE_CDR, _MODE_C = 70, 72
_PADS = np.concatenate([
    [10, 11, 70, 71], (_MODE_C + 1 + np.arange(3) + _MOTOR_STATE_C.itemsize * np.arange(MOTORS)[:, None]).ravel(),
])  # fmt: skip
LOW_STATE_SIZE = len(ENCAPSULATION) + LOW_STATE.itemsize - 4  #: Serialised LowState [bytes]
LOW_CMD_SIZE = len(ENCAPSULATION) + LOW_CMD.itemsize  #: Serialised LowCmd [bytes]
_REFLECTED = np.array([int(f"{byte:08b}"[::-1], 2) for byte in range(256)], dtype=np.uint8)  #: Bits of a byte reversed


def checksum(structure: bytes | NDArray[np.uint8]) -> int:
    """CRC-32/MPEG-2 of a C structure (size,) over its words, without the last one, which holds it."""
    data = np.frombuffer(structure, dtype=np.uint8)[:-4]
    words = _REFLECTED[data.reshape(-1, 4)[:, ::-1]]  # most significant byte first
    return int(f"{~zlib.crc32(words.tobytes()) & 0xFFFFFFFF:032b}"[::-1], 2)


def read_low_state(data: bytes) -> Any:
    """Record of dtype ``LOW_STATE`` from a serialised message; ``MessageError`` for a wrong size or checksum."""
    if len(data) != LOW_STATE_SIZE or data[:2] != ENCAPSULATION[:2]:
        raise MessageError(
            f"lowstate: {len(data)} bytes, {LOW_STATE_SIZE} in little-endian XCDR1 expected: no unitree_hg robot?"
        )
    body, header = np.frombuffer(data, dtype=np.uint8), len(ENCAPSULATION)
    structure = np.zeros(LOW_STATE.itemsize, dtype=np.uint8)
    structure[:_MODE_CDR] = body[header : header + _MODE_CDR]
    structure[_MODE_C] = body[header + _MODE_CDR]
    structure[_MODE_C + 4 :] = body[header + _MODE_CDR + 2 :]
    structure[_PADS] = 0  # arbitrary on the wire
    record = structure.view(LOW_STATE)[0]
    if (found := checksum(structure)) != record["crc"]:
        raise MessageError(f"lowstate: crc {int(record['crc']):#010x} instead of {found:#010x}")
    return record


def write_low_state(record: Any) -> bytes:
    """Serialise a record of dtype ``LOW_STATE``, with its checksum; for the robot's side of tests."""
    structure = np.frombuffer(record.tobytes(), dtype=np.uint8).copy()
    structure[_PADS] = 0
    structure[-4:] = np.frombuffer(checksum(structure).to_bytes(4, "little"), dtype=np.uint8)
    body = [structure[:_MODE_CDR], structure[_MODE_C : _MODE_C + 1], structure[:1] * 0, structure[_MODE_C + 4 :]]
    return ENCAPSULATION + b"".join(part.tobytes() for part in body)


def new_low_cmd() -> Any:
    """An empty record of dtype ``LOW_CMD``, for ``write_low_cmd``."""
    return np.zeros(1, dtype=LOW_CMD)[0]


def write_low_cmd(record: Any) -> bytes:
    """Serialise a record of dtype ``LOW_CMD``, with its checksum."""
    record["pad"] = 0
    record["crc"] = checksum(record.tobytes())
    return ENCAPSULATION + bytes(record.tobytes())


def read_low_cmd(data: bytes) -> Any:
    """Record of dtype ``LOW_CMD`` from a serialised message; ``MessageError`` for a wrong size or checksum."""
    if len(data) != LOW_CMD_SIZE or data[:2] != ENCAPSULATION[:2]:
        raise MessageError(f"lowcmd: {len(data)} bytes, {LOW_CMD_SIZE} in little-endian XCDR1 expected")
    record = np.frombuffer(bytearray(data[len(ENCAPSULATION) :]), dtype=LOW_CMD)[0]
    record["pad"] = 0
    record["motor_cmd"]["pad"] = 0
    if (found := checksum(record.tobytes())) != record["crc"]:
        raise MessageError(f"lowcmd: crc {int(record['crc']):#010x} instead of {found:#010x}")
    return record
