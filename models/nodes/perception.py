"""Camera and laser scanner: sensor_msgs/Image, CameraInfo and LaserScan."""

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, LaserScan

from models.camera import Pinhole
from models.errors import MessageError
from models.nodes.messages import set_stamp, stamp_ns, to_seconds
from models.profile import CAMERA_FRAME
from models.scan import SCAN_FRAME, Scan, check_scan

Picture = NDArray[np.uint8]  #: Rows of pixels of red, green, blue (height, width, 3)
#: Encodings that are read, and the order of their channels
ENCODINGS = {"rgb8": slice(None), "bgr8": slice(None, None, -1)}


def image_message(stamp: int, picture: Picture) -> Any:
    """sensor_msgs/Image with a stamp [ns]."""
    height, width, channels = picture.shape
    message = Image(height=height, width=width, encoding="rgb8", step=width * channels)
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = CAMERA_FRAME
    message.data = array("B", picture.tobytes())
    return message


def picture_of(message: Any) -> Picture:
    """Picture of a sensor_msgs/Image; ``MessageError`` for an unsupported encoding or inconsistent sizes."""
    if message.encoding not in ENCODINGS:
        raise MessageError(f"encoding: '{message.encoding[:16]}', expected one of {', '.join(ENCODINGS)}")
    width, height, step = message.width, message.height, message.step
    if step < 3 * width or len(message.data) != step * height or not width * height:
        raise MessageError(f"data: {len(message.data)} bytes for {width} x {height} pixels, {step} bytes a row")
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(height, step)
    picture: Picture = rows[:, : 3 * width].reshape(height, width, 3)[..., ENCODINGS[message.encoding]]
    return picture


def info_message(stamp: int, camera: Pinhole) -> Any:
    """sensor_msgs/CameraInfo with a stamp [ns] of a camera without distortion."""
    message = CameraInfo(height=camera.height, width=camera.width, distortion_model="plumb_bob", d=[0.0] * 5)
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = CAMERA_FRAME
    message.k, message.r = camera.matrix.ravel(), np.eye(3).ravel()
    message.p = np.column_stack([camera.matrix, np.zeros(3)]).ravel()
    return message


def pinhole_of(message: Any) -> Pinhole:
    """Camera of a sensor_msgs/CameraInfo; ``MessageError`` when it is uncalibrated or its images are distorted."""
    if any(message.d):
        raise MessageError("d: the pictures are distorted; rectify them first (image_proc), and remap to image_rect")
    fx, fy, cx, cy = (float(message.k[i]) for i in (0, 4, 2, 5))
    if not (np.isfinite([fx, fy, cx, cy]).all() and min(fx, fy, message.width, message.height) > 0):
        raise MessageError(f"k: focal lengths {fx:g}, {fy:g} of {message.width} x {message.height} pixels are none")
    return Pinhole(int(message.width), int(message.height), (fx, fy), (cx, cy))


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
    """Scan of a sensor_msgs/LaserScan; ``MessageError`` for another frame, inconsistent sizes, or by ``check_scan``."""
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
    # Drivers disagree whether a full turn repeats its first direction: one reading more or less is accepted.
    if not abs(scan.angle_max - message.angle_max) <= 1.5 * abs(scan.angle_increment):
        raise MessageError(f"ranges: {len(scan.ranges)} readings end at {scan.angle_max:.4f} rad, not at angle_max")
    if len(message.intensities) not in (0, len(scan.ranges)):
        raise MessageError(f"intensities: {len(message.intensities)} values for {len(scan.ranges)} ranges")
    return scan
