"""Cameras, laser scanner and point clouds: sensor_msgs/Image, CameraInfo, LaserScan and PointCloud2."""

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image, LaserScan, PointCloud2, PointField

from models.camera import Pinhole
from models.errors import MessageError
from models.nodes.messages import set_header, stamp_ns, to_seconds
from models.profile import CAMERA_FRAME
from models.range_sensor import DEPTH_FRAME, DEPTH_UNIT, POINTS_MAX, PointCloud, check_cloud
from models.scan import SCAN_FRAME, Scan, check_scan
from models.types import Matrix

Picture = NDArray[np.uint8]  #: RGB image (height, width, 3)
#: Supported encodings, and the order of their channels
ENCODINGS = {"rgb8": slice(None), "bgr8": slice(None, None, -1)}
_COORDINATES = ("x", "y", "z")


def image_message(stamp: int, picture: Picture) -> Any:
    """sensor_msgs/Image of encoding rgb8 with a stamp [ns]."""
    height, width, channels = picture.shape
    message = Image(height=height, width=width, encoding="rgb8", step=width * channels)
    set_header(message, stamp, CAMERA_FRAME)
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


def depth_message(stamp: int, depth: Matrix) -> Any:
    """sensor_msgs/Image of encoding 16UC1 with a stamp [ns] from depths (height, width) [m]; nan becomes 0."""
    height, width = depth.shape
    message = Image(height=height, width=width, encoding="16UC1", step=2 * width)
    set_header(message, stamp, DEPTH_FRAME)
    steps = np.clip(np.rint(np.nan_to_num(depth) / DEPTH_UNIT), 0, 65535)
    message.data = array("B", steps.astype("<u2").tobytes())
    return message


def cloud_message(stamp: int, cloud: PointCloud) -> Any:
    """sensor_msgs/PointCloud2 with a stamp [ns]: x, y and z as 32-bit floats, one row."""
    count = len(cloud.points)
    fields = [PointField(name=x, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, x in enumerate("xyz")]
    message = PointCloud2(height=1, width=count, fields=fields, point_step=12, row_step=12 * count, is_dense=True)
    set_header(message, stamp, cloud.frame)
    message.data = array("B", cloud.points.astype("<f4").tobytes())
    return message


def cloud_from_message(message: Any) -> PointCloud:
    """Cloud of a sensor_msgs/PointCloud2 with x, y, z as 32-bit floats in any layout; drops points that are not finite.

    Raises ``MessageError`` for a missing coordinate, another type, inconsistent sizes, or as ``check_cloud``.
    """
    count, step, order = message.width * message.height, message.point_step, ">" if message.is_bigendian else "<"
    offsets = {field.name: field.offset for field in message.fields if field.datatype == PointField.FLOAT32}
    missing = [name for name in _COORDINATES if name not in offsets]
    if missing:
        raise MessageError(f"fields: no {', '.join(missing)} of type FLOAT32")
    sized = message.row_step == message.width * step and len(message.data) == message.height * message.row_step
    if not sized or count > POINTS_MAX or any(offsets[name] + 4 > step for name in _COORDINATES):
        raise MessageError(
            f"data: {len(message.data)} bytes, {message.height} rows of {message.row_step}, for {message.width} points"
            f" of {step} bytes each, at most {POINTS_MAX}"
        )
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(count, step)
    columns = [rows[:, offsets[name] : offsets[name] + 4].copy().view(f"{order}f4")[:, 0] for name in _COORDINATES]
    xyz = np.column_stack(columns).astype(np.float64)
    cloud = PointCloud(
        to_seconds(stamp_ns(message.header.stamp)), message.header.frame_id, xyz[np.isfinite(xyz).all(axis=1)]
    )
    check_cloud(cloud)
    return cloud


def info_message(stamp: int, camera: Pinhole, frame: str = CAMERA_FRAME) -> Any:
    """sensor_msgs/CameraInfo with a stamp [ns] of a camera without distortion; ``frame`` is its optical frame."""
    message = CameraInfo(height=camera.height, width=camera.width, distortion_model="plumb_bob", d=[0.0] * 5)
    set_header(message, stamp, frame)
    message.k, message.r = camera.matrix.ravel(), np.eye(3).ravel()
    message.p = np.column_stack([camera.matrix, np.zeros(3)]).ravel()
    return message


def pinhole_of(message: Any) -> Pinhole:
    """Camera of a sensor_msgs/CameraInfo; ``MessageError`` when it is uncalibrated or its images are distorted."""
    if any(message.d):
        raise MessageError("d: the pictures are distorted; rectify them first (image_proc), and remap to image_rect")
    fx, fy, cx, cy = (float(message.k[i]) for i in (0, 4, 2, 5))
    if not (np.isfinite([fx, fy, cx, cy]).all() and min(fx, fy, message.width, message.height) > 0):
        raise MessageError(
            f"k: focal lengths {fx:g}, {fy:g} of {message.width} x {message.height} pixels are not valid"
        )
    return Pinhole(int(message.width), int(message.height), (fx, fy), (cx, cy))


def scan_to_message(stamp: int, scan: Scan, period: float) -> Any:
    """sensor_msgs/LaserScan with a stamp [ns] of a scan taken at one instant; ``period`` between two scans [s]."""
    message = LaserScan(
        angle_min=scan.angle_min,
        angle_max=scan.angle_max,
        angle_increment=scan.angle_increment,
        scan_time=period,
        range_min=scan.range_min,
        range_max=scan.range_max,
    )
    set_header(message, stamp, SCAN_FRAME)
    message.ranges = array("f", scan.ranges.astype(np.float32).tobytes())
    return message


def scan_from_message(message: Any) -> Scan:
    """Scan of a sensor_msgs/LaserScan; ``MessageError`` for another frame, inconsistent sizes, or as ``check_scan``."""
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
    # Some drivers repeat the first direction of a full turn: one reading more or less is accepted.
    if not abs(scan.angle_max - message.angle_max) <= 1.5 * abs(scan.angle_increment):
        raise MessageError(f"ranges: {len(scan.ranges)} readings end at {scan.angle_max:.4f} rad, not at angle_max")
    if len(message.intensities) not in (0, len(scan.ranges)):
        raise MessageError(f"intensities: {len(message.intensities)} values for {len(scan.ranges)} ranges")
    return scan
