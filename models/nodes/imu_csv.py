"""Log of the inertial unit as CSV; the file has its name only once it is complete."""

from __future__ import annotations

import csv
from pathlib import Path

import pinocchio as pin

from models.nodes.cdr import NANOSECONDS
from models.nodes.imu import ImuSample
from models.part_file import part_beside

COLUMNS = (
    "stamp_s",
    *("qx", "qy", "qz", "qw"),
    *("roll_rad", "pitch_rad", "yaw_rad"),
    *("wx_rad_s", "wy_rad_s", "wz_rad_s"),
    *("ax_m_s2", "ay_m_s2", "az_m_s2"),
)
"""Header of the CSV file: orientation of the inertial unit in odom, rate and specific force in its own frame."""


class CsvImuLog:
    """One line for each sample.

    Args:
        path: Where the file appears at ``close``.

    Raises:
        PoiseError: It cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, part_beside(path)
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
