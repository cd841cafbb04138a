"""Points of the robot itself, removed from a cloud."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.terrain.config import BodyConfig


class _Capsules(NamedTuple):
    """Capsules in the frames of joints."""

    joints: NDArray[np.int64]  # (k,)
    starts: Matrix  # (k, 3) [m]
    ends: Matrix  # (k, 3) [m]
    radii: Vector  # (k,) [m]


class BodyFilter:
    """Finds points within the hulls of the profile and along the soles, grown by ``config``."""

    def __init__(self, robot: RobotModel, config: BodyConfig) -> None:
        rows: list[tuple[int, Vector, Vector, float]] = []
        for hull in robot.profile.hulls.values():
            link = robot.pin.frames[robot.pin.getFrameId(hull.link, pin.FrameType.BODY)]
            ends = link.placement.act(np.array(hull.start)), link.placement.act(np.array(hull.end))
            rows.append((link.parentJoint, *ends, hull.radius + config.margin))
        for foot in robot.feet:
            sole = robot.pin.frames[foot.frame_id]
            x_min, x_max, y_min, y_max = foot.rectangle
            middle = 0.5 * (y_min + y_max)
            # the capsule ends at the sole: below it there is ground
            ends = tuple(sole.placement.act(np.array([x, middle, config.foot])) for x in (x_min, x_max))
            rows.append((sole.parentJoint, *ends, config.foot))
        joints, starts, finishes, radii = zip(*rows, strict=True)
        self._capsules = _Capsules(np.array(joints), np.array(starts), np.array(finishes), np.array(radii))

    def outside(self, points: Matrix, data: pin.Data) -> NDArray[np.bool_]:
        """Whether each point of W (n, 3) [m] is outside the robot, whose joints are placed as in ``data`` (n,)."""
        local = self._capsules
        places = [data.oMi[int(joint)] for joint in local.joints]
        starts = np.array([place.act(point) for place, point in zip(places, local.starts, strict=True)])
        ends = np.array([place.act(point) for place, point in zip(places, local.ends, strict=True)])
        return _outside(points, starts, ends, local.radii)


@njit(cache=True)
def _outside(points: Matrix, starts: Matrix, ends: Matrix, radii: Vector) -> NDArray[np.bool_]:
    free = np.ones(len(points), dtype=np.bool_)
    for k in range(len(radii)):
        ax, ay, az = starts[k]
        dx, dy, dz = ends[k, 0] - ax, ends[k, 1] - ay, ends[k, 2] - az
        length, square = max(dx * dx + dy * dy + dz * dz, 1e-12), radii[k] * radii[k]
        for i in range(len(points)):
            x, y, z = points[i, 0] - ax, points[i, 1] - ay, points[i, 2] - az
            share = min(max((x * dx + y * dy + z * dz) / length, 0.0), 1.0)
            x, y, z = x - share * dx, y - share * dy, z - share * dz
            if x * x + y * y + z * z < square:
                free[i] = False
    return free
