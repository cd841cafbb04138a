"""Scans as sensor_msgs/LaserScan."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from sensor_msgs.msg import LaserScan

from models.errors import MessageError
from models.nodes.messages import set_stamp, stamp_ns, to_seconds
from models.scan import SCAN_FRAME, Scan, check_scan


def scan_to_message(stamp: int, scan: Scan, period: float) -> Any:
    """sensor_msgs/LaserScan with a stamp [ns] of a scan that was taken at one instant, one every period [s]."""
    message = LaserScan(
        angle_min=scan.angle_min,
        angle_max=scan.angle_max,
        angle_increment=scan.angle_increment,
        scan_time=period,
        range_min=scan.range_min,
        range_max=scan.range_max,
    )
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = SCAN_FRAME
    message.ranges = array("f", scan.ranges.astype(np.float32).tobytes())
    return message


def scan_from_message(message: Any) -> Scan:
    """Scan of a sensor_msgs/LaserScan.

    Raises:
        MessageError: Another frame than ``scan``, sizes that do not match, or what ``check_scan`` refuses; the field
            is named.
    """
    frame = message.header.frame_id
    if frame != SCAN_FRAME:
        raise MessageError(f"header.frame_id: '{frame[:32]}' instead of '{SCAN_FRAME}'")
    scan = Scan(
        t=to_seconds(stamp_ns(message.header.stamp)),
        angle_min=message.angle_min,
        angle_increment=message.angle_increment,
        ranges=np.array(message.ranges, dtype=np.float64),
        range_min=message.range_min,
        range_max=message.range_max,
    )
    check_scan(scan)
    # Drivers disagree whether a full turn repeats its first direction: one reading more or less is no mistake.
    if not abs(scan.angle_max - message.angle_max) <= 1.5 * abs(scan.angle_increment):
        raise MessageError(f"ranges: {len(scan.ranges)} readings end at {scan.angle_max:.4f} rad, not at angle_max")
    if len(message.intensities) not in (0, len(scan.ranges)):
        raise MessageError(f"intensities: {len(message.intensities)} values for {len(scan.ranges)} ranges")
    return scan
