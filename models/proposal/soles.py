"""Contact geometry: the flat part of each foot, and coarse hulls of the links that hit the floor first in a fall."""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from models.errors import RobotModelError
from models.foot import LENGTH, NORMAL
from models.profile import Hull
from models.proposal.config import SoleConfig
from models.proposal.shapes import Finding, link_points, links_by_name
from models.proposal.skeleton import BASE, Legs, Limbs, Skeleton, freedoms
from models.types import Matrix, Vector

_WIDER = (1.0, 2.5, 5.0)  #: Factors on the band of points of a sole, tried in order until the sole is large enough
_SAME_WAY = np.cos(np.radians(3.0))  #: Minimum cosine between the normals of facets of one face
_LEVEL = np.radians(2.0)  #: Tilt at zero below which a face counts as level, because meshes are coarse [rad]
_AS_LARGE = 0.9  #: Minimum area of a face that counts as equally large, over the largest [-]
_GRID = 48  #: Grid points along the sole for the ends of the largest rectangle [1]
_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True)
class SoleShape:
    """Detected sole."""

    link: str  # link moved by the last joint of the leg
    placement: pin.SE3  # pose of the sole frame in that link: origin under the ankle, x forward, z up
    rectangle: tuple[float, float, float, float]  # x_min, x_max, y_min, y_max in the sole frame [m]
    findings: tuple[Finding, ...]


def foot_points(robot: ET.Element, skeleton: Skeleton, joint: int) -> Matrix:
    """Points (n, 3) [m] of a foot relative to its last joint, in the axes of the base at zero."""
    elements = links_by_name(robot)
    clouds = [skeleton.points(elements[name]) - skeleton.origins[joint] for name in skeleton.links(joint)]
    return np.vstack([np.zeros((0, 3)), *clouds])


def find_sole(robot: ET.Element, skeleton: Skeleton, leg: tuple[int, ...], config: SoleConfig, urdf: Path) -> SoleShape:
    """Find the largest rectangle in the bottom face of a foot; ``RobotModelError`` if it is too small.

    The face is the largest set of parallel facets of the hull that point down. The outline of the sole is the hull of
    all points at most ``band`` above the lowest one. ``leg`` are the joints from hip to foot.
    """
    ankle = leg[-1]
    link, free = skeleton.links(ankle)[0], freedoms(skeleton, leg)
    length = skeleton.reach(list(leg))
    points = foot_points(robot, skeleton, ankle)
    findings: list[Finding] = []
    if not len(points):
        heel, toe, half = (round(length * part, 3) for part in (config.heel, config.toe, config.half_width))
        rectangle = -heel, toe, -half, half
        text = f"no shape below joint '{skeleton.name(ankle)}': size and height of the sole are unknown"
        remedy = (
            f"assumed {1e3 * length * config.ankle:.0f} mm below the joint, with a usual size: give the foot a shape"
        )
        findings.append(Finding("wrong", f"link '{link}'", text, remedy))
        rotation, depth = np.eye(3), length * config.ankle
    else:
        normal = _face(points)
        if float(normal @ _DOWN) < np.cos(_LEVEL):
            angle = np.degrees(np.arccos(float(normal @ _DOWN)))
            text = f"the foot is not flat at zero: its sole is tilted by {angle:.0f} deg"
            findings.append(Finding("note", f"link '{link}'", text, "the sole frame is turned"))
        else:
            normal = _DOWN
        forward = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
        forward /= np.linalg.norm(forward)
        rotation = np.column_stack([forward, np.cross(-normal, forward), -normal])
        local = points @ rotation  # in the axes of the sole
        depth = -float(local[:, 2].min())
        least = length * config.length_min, 0.0 if free[LENGTH] else length * config.width_min
        rectangle = _outline(local, config, least, f"{urdf}: no feet: link '{link}'", findings, link)
    if free[LENGTH]:
        width = 1e3 * (rectangle[3] - rectangle[2])
        text = f"{len(leg)} joints do not hold the sole against rolling: it bears on a line, and steps balance sideways"
        findings.append(
            Finding("note", f"link '{link}'", text, f"{width:.0f} mm wide; the wider, the more a walk drifts")
        )
    if free[NORMAL]:
        text = f"{len(leg)} joints do not turn the sole about the vertical: the robot faces the direction of its feet"
        findings.append(Finding("note", f"link '{link}'", text, "it walks, but does not turn"))
    in_base = pin.SE3(rotation, skeleton.origins[ankle] - depth * rotation[:, 2])
    return SoleShape(link, skeleton.place(link).actInv(in_base), rectangle, tuple(findings))


def _face(points: Matrix) -> Vector:
    """Outward normal of the largest face of the hull that points down (3,), for points (n, 3) [m]."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # fewer than four points, or all in one plane
        return _DOWN
    normals = hull.equations[:, :3]
    corners = points[hull.simplices]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    same = normals @ normals.T > _SAME_WAY
    sizes = np.where(normals[:, 2] < -0.5, same @ areas, 0.0)
    alike = sizes >= _AS_LARGE * sizes.max()  # a cylinder has many such faces; use the most level one
    mean = (areas * same[int(np.where(alike, normals[:, 2], np.inf).argmin())]) @ normals
    return np.asarray(mean / np.linalg.norm(mean))


def _outline(
    points: Matrix, config: SoleConfig, least: tuple[float, float], where: str, findings: list[Finding], link: str
) -> tuple[float, float, float, float]:
    """Largest rectangle of a sole; ``RobotModelError`` unless it is longer and wider than ``least`` [m]."""
    low = points[:, 2].min()
    size = (0.0, 0.0)
    for wider in _WIDER:
        flat = points[points[:, 2] < low + wider * config.band, :2]
        rectangle = largest_rectangle(flat)
        if rectangle is None:
            continue
        x_min, x_max, y_min, y_max = rectangle + config.inset * np.array([1.0, -1.0, 1.0, -1.0])
        size = max(x_max - x_min, 0.0), max(y_max - y_min, 0.0)
        if size[0] > least[0] and size[1] > least[1]:
            if wider > 1.0:
                text = f"the sole is not flat: its rectangle uses the lowest {1e3 * wider * config.band:.0f} mm"
                findings.append(Finding("wrong", f"link '{link}'", text, "treated as flat"))
            return round(x_min, 4), round(x_max, 4), round(y_min, 4), round(y_max, 4)
    raise RobotModelError(
        f"{where} has no flat sole: {1e3 * size[0]:.0f} x {1e3 * size[1]:.0f} mm, at least "
        f"{1e3 * least[0]:.0f} x {1e3 * least[1]:.0f} mm"
    )


def largest_rectangle(points: Matrix) -> Vector | None:
    """Largest axis-aligned rectangle within the hull of points (n, 2) [m]; None if they span no area.

    Returns x_min, x_max, y_min, y_max (4,) [m]. A convex hull is narrowest at one end of an interval of x, so the
    bounds in y follow from the two ends.
    """
    try:
        corners = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        return None
    x = np.linspace(corners[:, 0].min(), corners[:, 0].max(), _GRID)
    lower, upper = np.full(_GRID, np.inf), np.full(_GRID, -np.inf)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        inside = (x >= min(a[0], b[0]) - 1e-12) & (x <= max(a[0], b[0]) + 1e-12)
        share = (x - a[0]) / (b[0] - a[0]) if b[0] != a[0] else np.zeros(_GRID)
        y = a[1] + np.clip(share, 0.0, 1.0) * (b[1] - a[1])
        ends = (y, y) if b[0] != a[0] else (np.full(_GRID, a[1]), np.full(_GRID, b[1]))
        for values in ends:
            lower = np.where(inside, np.minimum(lower, values), lower)
            upper = np.where(inside, np.maximum(upper, values), upper)
    bottom, top = np.maximum.outer(lower, lower), np.minimum.outer(upper, upper)  # (first, last)
    areas = np.maximum(x[None, :] - x[:, None], 0.0) * np.maximum(top - bottom, 0.0)
    first, last = np.unravel_index(int(areas.argmax()), areas.shape)
    if areas[first, last] <= 0.0:
        return None
    return np.array([x[first], x[last], bottom[first, last], top[first, last]])


_LEAST = 0.02  #: Minimum radius of a hull [m]


def propose_hulls(robot: ET.Element, skeleton: Skeleton, legs: Legs, limbs: Limbs) -> dict[str, Hull]:
    """Capsules within the bounding boxes of the links that hit the floor first in a fall."""
    parts = {"pelvis": BASE}
    if limbs.torso != BASE:
        parts["torso"] = limbs.torso
    heads = [j for j in skeleton.children[limbs.torso] if skeleton.central(j)]
    if heads:
        parts["head"] = skeleton.below(heads[0])[-1]
    for side, leg, arm in zip(("left", "right"), legs.both, limbs.arms, strict=True):
        parts[f"{side}_thigh"] = leg[len(leg) // 2 - 1]
        if arm:
            parts[f"{side}_hand"] = arm[-1]
    elements = links_by_name(robot)
    hulls = {}
    for part, joint in parts.items():
        for link in skeleton.links(joint):
            points = link_points(elements[link], np.eye(3))
            if len(points) and (hull := _capsule(link, points.min(axis=0), points.max(axis=0))) is not None:
                hulls[part] = hull
                break
    return hulls


def _capsule(link: str, low: Vector, high: Vector) -> Hull | None:
    """Capsule along the longest side of a box (corners (3,) [m]), as thick as its shortest side; None if too thin."""
    size = high - low
    longest = int(size.argmax())
    radius = 0.5 * float(np.delete(size, longest).min())
    if radius < _LEAST:
        return None
    ends = np.array([0.5 * (low + high)] * 2)
    ends[:, longest] += np.array([-1.0, 1.0]) * (0.5 * size[longest] - radius)
    (x1, y1, z1), (x2, y2, z2) = np.round(ends, 3).tolist()
    return Hull(link=link, start=(x1, y1, z1), end=(x2, y2, z2), radius=round(radius, 3))
