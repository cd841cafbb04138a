"""One scan of a planar laser scanner, and its validation."""

import math
from dataclasses import dataclass

import numpy as np

from models.errors import MessageError
from models.types import Matrix, Vector

SCAN_FRAME = "scan"  #: Frame of the scanner in the profile: x forward, z up
RANGES_MAX = 20000  #: Maximum readings of a scan [1]; the finest scanners have about 8000


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Readings of a planar scanner, counter-clockwise about z of frame ``scan``, as in sensor_msgs/LaserScan."""

    t: float  # stamp [s]
    angle_min: float  # direction of the first reading in frame ``scan``, from x towards y [rad]
    angle_increment: float  # from one reading to the next; negative for a clockwise scanner [rad]
    ranges: Vector  # (n,) [m]; +inf: nothing in range, -inf: too close to measure, nan: no reading (REP 117)
    range_min: float  # shortest valid distance [m]
    range_max: float  # longest valid distance [m]

    @property
    def angle_max(self) -> float:
        """Direction of the last reading [rad]."""
        return self.angle_min + self.angle_increment * (len(self.ranges) - 1)

    @property
    def points(self) -> Matrix:
        """Measured points in the scanner's plane (k, 2) [m]; too close readings count as ``range_min``."""
        ranges = np.where(np.isneginf(self.ranges), self.range_min, self.ranges)
        index = np.flatnonzero((ranges >= self.range_min) & (ranges <= self.range_max))
        angles, ranges = self.angle_min + self.angle_increment * index, ranges[index]
        return np.column_stack([ranges * np.cos(angles), ranges * np.sin(angles)])


def check_scan(scan: Scan) -> None:
    """Raise ``MessageError`` for a malformed scan, naming the field."""
    for name in ("t", "angle_min", "angle_increment", "range_min", "range_max"):
        value = getattr(scan, name)
        if not math.isfinite(value):
            raise MessageError(f"{name} is {value}")
    if scan.angle_increment == 0.0:
        raise MessageError("angle_increment is 0")
    if scan.ranges.ndim != 1 or not 1 <= len(scan.ranges) <= RANGES_MAX:
        raise MessageError(f"ranges: shape {scan.ranges.shape} instead of 1 to {RANGES_MAX} readings in a row")
    turn = abs(scan.angle_increment) * (len(scan.ranges) - 1)
    if turn > 2.0 * math.pi + 1e-3:
        raise MessageError(f"angle_increment: {len(scan.ranges)} readings span {turn:.3f} rad, more than a turn")
    if not 0.0 <= scan.range_min < scan.range_max:
        raise MessageError(
            f"range_min {scan.range_min} m and range_max {scan.range_max} m: 0 <= range_min < range_max required"
        )
    if np.isnan(scan.ranges).all():
        raise MessageError("ranges: every reading is nan")
