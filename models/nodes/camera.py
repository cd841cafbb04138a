"""Pictures as sensor_msgs/Image, and the camera that took them as sensor_msgs/CameraInfo."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image

from models.camera import Pinhole
from models.errors import MessageError
from models.nodes.messages import set_stamp
from models.profile import CAMERA_FRAME

Picture = NDArray[np.uint8]
"""Rows of pixels of red, green, blue (height, width, 3)."""

ENCODINGS = {"rgb8": slice(None), "bgr8": slice(None, None, -1)}
"""Encodings that are read, and the order of their channels."""


def image_message(stamp: int, picture: Picture) -> Any:
    """sensor_msgs/Image with a stamp [ns]."""
    height, width, channels = picture.shape
    message = Image(height=height, width=width, encoding="rgb8", step=width * channels)
    set_stamp(message.header.stamp, stamp)
    message.header.frame_id = CAMERA_FRAME
    message.data = array("B", picture.tobytes())
    return message


def picture_of(message: Any) -> Picture:
    """Picture of a sensor_msgs/Image.

    Raises:
        MessageError: An encoding that is not read here, or sizes that do not match; the field is named.
    """
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
    """Camera of a sensor_msgs/CameraInfo.

    Raises:
        MessageError: Its pictures are distorted, so that no pinhole describes them, or it is not calibrated.
    """
    if any(message.d):
        raise MessageError("d: the pictures are distorted; rectify them first (image_proc), and remap to image_rect")
    fx, fy, cx, cy = (float(message.k[i]) for i in (0, 4, 2, 5))
    if not (np.isfinite([fx, fy, cx, cy]).all() and min(fx, fy, message.width, message.height) > 0):
        raise MessageError(f"k: focal lengths {fx:g}, {fy:g} of {message.width} x {message.height} pixels are none")
    return Pinhole(int(message.width), int(message.height), (fx, fy), (cx, cy))
