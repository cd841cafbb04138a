"""Depth cameras and lidars: their schema in the robot profile, and their point clouds."""

from __future__ import annotations

import math
from dataclasses import dataclass as record
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive
from models.errors import MessageError
from models.types import Matrix, Vector

DEPTH_FRAME = "depth_optical_frame"  #: Frame of the depth camera: x right, y down, z forward (REP-103)
LIDAR_FRAME = "lidar"  #: Frame of the lidar, z along its axis of rotation
DEPTH_UNIT = 0.001  #: Unit of the pixels of a depth image, as published by depth cameras [m]
POINTS_MAX = 500_000  #: Maximum points of a cloud [1]; a depth image of 848 x 480 has 407 040

Elevation = Annotated[float, Field(ge=-1.5708, le=1.5708)]


@dataclass(frozen=True, slots=True, config=STRICT)
class RangeSensor:
    """Common fields of depth camera and lidar; a depth camera measures along its axis, a lidar along the ray."""

    range_min: NonNegative  #: minimum measured distance [m]
    range_max: Positive  #: maximum measured distance [m]
    rate: Annotated[float, Field(gt=0.0, le=1000.0)]  #: images or turns per second [Hz]
    noise: NonNegative  #: standard deviation of a distance, constant part [m]
    noise_square: NonNegative  #: standard deviation of a distance, coefficient of the squared distance [1/m]
    scale: NonNegative  #: standard deviation of the scale error between sensors [-]
    misalignment: NonNegative  #: standard deviation of the mounting rotation, each axis [rad]
    latency: NonNegative  #: from exposure to the arrival of the points [s]

    def __post_init__(self) -> None:
        if self.range_min >= self.range_max:
            raise ValueError(f"range_min {self.range_min} m is not below range_max {self.range_max} m")

    def deviation(self, distance: Vector) -> Vector:
        """Standard deviation of the noise of distances (n,) [m]."""
        return self.noise + self.noise_square * distance**2


@dataclass(frozen=True, slots=True, config=STRICT)
class DepthSensor(RangeSensor):
    """A depth camera without distortion at frame `depth_optical_frame`: x right, y down, z forward (REP-103)."""

    width: Annotated[int, Field(ge=16, le=4096)]  #: image width [pixel]
    height: Annotated[int, Field(ge=16, le=4096)]  #: image height [pixel]
    horizontal_fov: Annotated[float, Field(ge=0.1, le=2.8)]  #: horizontal field of view [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class LidarSensor(RangeSensor):
    """A lidar with 360 deg coverage about the z axis of frame `lidar`; every turn has a different pattern."""

    elevation_min: Elevation  #: elevation of the lowest ray above the x-y plane of the frame [rad]
    elevation_max: Elevation  #: elevation of the highest ray [rad]
    rays: Annotated[int, Field(ge=2, le=POINTS_MAX)]  #: number of rays per turn [1]


@record(frozen=True, slots=True, eq=False)
class PointCloud:
    """Points of a range sensor measured at one instant; rays without a measurement are omitted."""

    t: float  # time of exposure [s]
    frame: str  # frame of the points, as named in the profile
    points: Matrix  # (n, 3) [m]


def check_cloud(cloud: PointCloud) -> None:
    """Raise ``MessageError`` for a malformed cloud, naming the field."""
    if not math.isfinite(cloud.t):
        raise MessageError(f"t is {cloud.t}")
    shape = cloud.points.shape
    if len(shape) != 2 or shape[1] != 3 or shape[0] > POINTS_MAX:
        raise MessageError(f"points: shape {shape} instead of (n, 3) with up to {POINTS_MAX} points")
    if not np.isfinite(cloud.points).all():
        raise MessageError("points: a coordinate is not finite")
