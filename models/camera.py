"""Pinhole camera: direction of a pixel, and projection of a point."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from models.profile import CameraSensor
from models.range_sensor import DepthSensor
from models.types import Matrix, Vector


@dataclass(frozen=True, slots=True)
class Pinhole:
    r"""Intrinsics of a camera with rectified images, in the optical frame: x right, y down, z forward (REP-103).

    .. math::
        u = f x / z + c_x, \quad v = f y / z + c_y
    """

    width: int  # [pixel]
    height: int  # [pixel]
    focal: tuple[float, float]  # focal lengths f along u and v [pixel]
    centre: tuple[float, float]  # principal point c; the centre of the first pixel is (0, 0) [pixel]

    @classmethod
    def of(cls, camera: CameraSensor | DepthSensor) -> Pinhole:
        """Ideal camera of a profile: square pixels, optical axis through the centre of the image."""
        focal = 0.5 * camera.width / math.tan(0.5 * camera.horizontal_fov)
        middle = 0.5 * (camera.width - 1), 0.5 * (camera.height - 1)
        return cls(camera.width, camera.height, (focal, focal), middle)

    @property
    def matrix(self) -> Matrix:
        """Camera matrix K (3, 3)."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    @property
    def rays(self) -> Matrix:
        """Direction of each pixel in the optical frame with z = 1, row by row (height * width, 3)."""
        v, u = np.indices((self.height, self.width)).reshape(2, -1)
        (fx, fy), (cx, cy) = self.focal, self.centre
        return np.column_stack([(u - cx) / fx, (v - cy) / fy, np.ones(self.width * self.height)])

    def project(self, point: Vector) -> Vector:
        """Pixel (2,) of a point in front of the camera (3,) [m]."""
        pixel: Vector = np.array(self.focal) * point[:2] / point[2] + np.array(self.centre)
        return pixel

    def bearing(self, pixel: Vector) -> Vector:
        """Unit vector in the optical frame (3,) along the ray of a pixel (2,)."""
        ray = np.append((pixel - np.array(self.centre)) / np.array(self.focal), 1.0)
        bearing: Vector = ray / np.linalg.norm(ray)
        return bearing


def azimuth_elevation(bearing: Vector) -> tuple[float, float]:
    """Azimuth (left positive) and elevation (up positive) of a direction (3,) in the optical frame [rad]."""
    x, y, z = (float(value) for value in bearing)
    return math.atan2(-x, z), math.atan2(-y, math.hypot(x, z))
