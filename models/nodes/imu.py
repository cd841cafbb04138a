"""sensor_msgs/Imu with orientation, as messages and as CSV."""

import csv
from dataclasses import dataclass
from pathlib import Path

import pinocchio as pin
from sensor_msgs.msg import Imu

from models.errors import MessageError
from models.files import part_beside
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import Codec
from models.types import Matrix, Vector


@dataclass(frozen=True, slots=True)
class ImuSample:
    """Measurement of the IMU with biases removed, and orientation estimate."""

    orientation: Vector  #: Orientation of the IMU in ``odom``, quaternion xyzw (4,)
    covariance: Matrix  #: Covariance of the orientation, rotation about the fixed axes of ``odom`` (3, 3) [rad^2]
    gyro: Vector  #: Angular velocity in the IMU frame (3,) [rad/s]
    accel: Vector  #: Specific force in the IMU frame (3,) [m/s^2]


class OrientedImuCodec:
    """``ImuSample`` as message; the covariances of rate and force are 0, meaning unknown."""

    def __init__(self, frame_id: str) -> None:
        message = Imu()
        message.header.frame_id = frame_id
        fields = ("orientation", "orientation_covariance", "angular_velocity", "linear_acceleration")
        self._codec = Codec[tuple[int, Vector, Vector, Vector, Vector]](message, fields)

    def encode(self, stamp: int, sample: ImuSample) -> bytes:
        """Serialised message from a stamp [ns] and a sample."""
        return self._codec.encode(stamp, sample.orientation, sample.covariance.ravel(), sample.gyro, sample.accel)

    def decode(self, data: bytes) -> tuple[int, ImuSample]:
        """Stamp [ns] and sample; ``MessageError`` for another type, missing orientation, NaN or infinity."""
        stamp, orientation, covariance, gyro, accel = self._codec.decode(data)
        if covariance[0] < 0.0:
            raise MessageError("orientation_covariance: there is no orientation")
        return stamp, ImuSample(orientation, covariance.reshape(3, 3), gyro, accel)


#: Header of the CSV file: orientation of the IMU in odom, angular velocity and specific force in the IMU frame
COLUMNS = (
    "stamp_s",
    *("qx", "qy", "qz", "qw"),
    *("roll_rad", "pitch_rad", "yaw_rad"),
    *("wx_rad_s", "wy_rad_s", "wz_rad_s"),
    *("ax_m_s2", "ay_m_s2", "az_m_s2"),
)


class CsvImuLog:
    """CSV file with one line per sample; created at its path by ``close``. ``PoiseError`` if it cannot be written."""

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

    def close(self, *, keep: bool = True) -> None:
        """Complete the file and move it to its path, or delete it."""
        self._file.close()
        if keep:
            self._part.replace(self._path)
        else:
            self._part.unlink()
