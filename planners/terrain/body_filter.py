"""Filter for points of a cloud that lie on the robot itself."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from models.numerics.compiled import njit
from models.robot_model import RobotModel
from models.types import Matrix, Vector
from planners.terrain.config import BodyConfig


class _End(NamedTuple):
    """End of a capsule."""

    joint: int  # joint in whose frame ``place`` is given
    place: Vector  # (3,) [m]


class _Capsule(NamedTuple):
    """All points within a distance of a segment."""

    start: _End
    end: _End
    radius: float  # [m]


class BodyFilter:
    """Detects points in capsules on the robot: hulls of the profile, along the soles, and links between these.

    A link joins each capsule to the nearest one of the next joint above; links cover wrists and ankles without hulls.
    """

    def __init__(self, robot: RobotModel, config: BodyConfig) -> None:
        capsules: list[_Capsule] = []
        for hull in robot.profile.hulls.values():
            link = robot.pin.frames[robot.pin.getFrameId(hull.link, pin.FrameType.BODY)]
            start, end = (_End(link.parentJoint, link.placement.act(np.array(x))) for x in (hull.start, hull.end))
            capsules.append(_Capsule(start, end, hull.radius + config.margin))
        for foot in robot.feet:
            sole = robot.pin.frames[foot.frame_id]
            x_min, x_max, y_min, y_max = foot.rectangle
            inset = min(0.5 * config.foot, 0.5 * (y_max - y_min))
            for y in sorted({y_min + inset, y_max - inset}):
                # the capsule ends at the sole, since there is ground below it
                places = [sole.placement.act(np.array([x, y, config.foot])) for x in (x_min, x_max)]
                start, end = (_End(sole.parentJoint, place) for place in places)
                capsules.append(_Capsule(start, end, config.foot))
        capsules += _between(robot, capsules)
        self._capsules, self._radii = capsules, np.array([capsule.radius for capsule in capsules])

    def outside(self, points: Matrix, data: pin.Data) -> NDArray[np.bool_]:
        """Whether each point of W (n, 3) [m] is outside the robot (n,), with the joint placements of ``data``."""
        starts = np.array([data.oMi[each.start.joint].act(each.start.place) for each in self._capsules])
        ends = np.array([data.oMi[each.end.joint].act(each.end.place) for each in self._capsules])
        return _outside(points, starts, ends, self._radii)


def _between(robot: RobotModel, capsules: Sequence[_Capsule]) -> list[_Capsule]:
    """Capsules that link each one, at the nearest ends, to the next joint above that has capsules."""
    data, found = robot.data(), []
    pin.forwardKinematics(robot.pin, data, robot.standing_configuration())
    of: dict[int, list[_Capsule]] = {}
    for capsule in capsules:
        of.setdefault(capsule.start.joint, []).append(capsule)

    def apart(pair: tuple[_End, _End]) -> float:
        first, second = (data.oMi[end.joint].act(end.place) for end in pair)
        return float(np.linalg.norm(first - second))

    for capsule in capsules:
        above = robot.pin.parents[capsule.start.joint]
        while above and above not in of:
            above = robot.pin.parents[above]
        pairs = [
            (own, end, min(capsule.radius, other.radius))
            for other in of.get(above, [])
            for own in (capsule.start, capsule.end)
            for end in (other.start, other.end)
        ]
        if pairs:
            found.append(_Capsule(*min(pairs, key=lambda pair: apart(pair[:2]))))
    return found


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
