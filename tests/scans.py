"""Made-up scans."""

import math
from dataclasses import replace

import numpy as np

from models.robot_model import RobotModel
from models.scan import Scan

RAYS = 720


def empty(t: float) -> Scan:
    """Nothing in range, all round."""
    step = 2.0 * math.pi / RAYS
    return Scan(t, -math.pi, step, np.full(RAYS, math.inf), 0.02, 12.0)


def posts(model: RobotModel, t: float, *places: tuple[float, float]) -> Scan:
    """Thin posts at places in B (2,) [m], each hit by three rays."""
    scan = empty(t)
    mount = model.profile.frames["scan"].xyz
    for x, y in places:
        x, y = x - mount[0], y - mount[1]
        middle = round((math.atan2(y, x) - scan.angle_min) / scan.angle_increment)
        scan.ranges[np.arange(middle - 1, middle + 2) % RAYS] = math.hypot(x, y)
    return scan


def wall(model: RobotModel, t: float, distance: float) -> Scan:
    """A wall across the way, at a distance ahead of B's origin [m]."""
    scan = empty(t)
    angles = scan.angle_min + scan.angle_increment * np.arange(RAYS)
    with np.errstate(divide="ignore"):
        ranges = (distance - model.profile.frames["scan"].xyz[0]) / np.cos(angles)
    return replace(scan, ranges=np.where((ranges > 0.0) & (ranges < 12.0), ranges, math.inf))
