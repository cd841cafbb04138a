"""Logs of the inertial unit as CSV and MCAP; a file has its name only once it is complete."""

from __future__ import annotations

import csv
from importlib.metadata import version
from pathlib import Path
from typing import Protocol

import pinocchio as pin
from mcap.writer import Writer

from models.errors import PoiseError
from models.nodes.cdr import NANOSECONDS
from models.nodes.imu import ImuSample

COLUMNS = (
    "stamp_s",
    *("qx", "qy", "qz", "qw"),
    *("roll_rad", "pitch_rad", "yaw_rad"),
    *("wx_rad_s", "wy_rad_s", "wz_rad_s"),
    *("ax_m_s2", "ay_m_s2", "az_m_s2"),
)
"""Header of the CSV file: orientation of the inertial unit in odom, rate and specific force in its own frame."""


class ImuLog(Protocol):
    """Takes samples until it is closed."""

    def add(self, stamp: int, sample: ImuSample, data: bytes) -> None:
        """Write a sample of a stamp [ns], which came as these bytes."""
        ...

    def close(self) -> None:
        """Complete the file and give it its name."""
        ...

    def discard(self) -> None:
        """Leave no file."""
        ...


class CsvImuLog:
    """One line for each sample.

    Args:
        path: Where the file appears at ``close``.

    Raises:
        PoiseError: It cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, _part(path)
        self._file = self._part.open("w", newline="", encoding="utf-8")
        self._writer = csv.writer(self._file)
        self._writer.writerow(COLUMNS)

    def add(self, stamp: int, sample: ImuSample, data: bytes) -> None:
        """Write a line; see ``COLUMNS``."""
        rpy = pin.rpy.matrixToRpy(pin.Quaternion(sample.orientation).matrix())
        numbers = (*sample.orientation, *rpy, *sample.gyro, *sample.accel)
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        self._writer.writerow([f"{seconds}.{nanoseconds:09d}", *(f"{number:.9g}" for number in numbers)])

    def close(self) -> None:
        """Complete the file and give it its name."""
        self._file.close()
        self._part.replace(self._path)

    def discard(self) -> None:
        """Leave no file."""
        self._file.close()
        self._part.unlink()


class McapImuLog:
    """The messages as they came, for Foxglove, PlotJuggler and ``ros2 bag``.

    Args:
        path: Where the file appears at ``close``.
        topic: Name of the topic.
        definition: Text of sensor_msgs/Imu and what it consists of.

    Raises:
        PoiseError: It cannot be written.
    """

    def __init__(self, path: Path, topic: str, definition: str) -> None:
        self._path, self._part = path, _part(path)
        self._file = self._part.open("wb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library=f"poise {version('poise')}")
        schema = self._writer.register_schema("sensor_msgs/msg/Imu", "ros2msg", definition.encode())
        self._channel = self._writer.register_channel(topic, "cdr", schema)
        self._count = 0

    def add(self, stamp: int, sample: ImuSample, data: bytes) -> None:
        """Write the message with its own stamp as the time of the log."""
        self._writer.add_message(self._channel, stamp, data, stamp, self._count)
        self._count += 1

    def close(self) -> None:
        """Complete the file and give it its name."""
        self._writer.finish()
        self._file.close()
        self._part.replace(self._path)

    def discard(self) -> None:
        """Leave no file."""
        self._file.close()
        self._part.unlink()


def _part(path: Path) -> Path:
    """File beside ``path`` to write into."""
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.touch()
    except OSError as error:
        raise PoiseError(f"{path} cannot be written: {error}") from error
    if path.is_dir():
        part.unlink()
        raise PoiseError(f"{path} cannot be written: it is a folder")
    return part
