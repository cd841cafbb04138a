"""URDF as XML: findings, links, joints, and points of shapes; meshes that MuJoCo cannot read become boxes."""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Literal

import coal
import numpy as np
import pinocchio as pin

from models.types import Matrix, Vector
from models.urdf import resolve_uri

#: 'note': a gap that the proposal fills; 'wrong': the description is inconsistent, or such a robot cannot stand
Severity = Literal["note", "wrong"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a robot description."""

    severity: Severity
    culprit: str  # joint, link or file, as in "joint 'left_knee'"
    fault: str  # missing or wrong part
    remedy: str  # action of the proposal


@dataclass(frozen=True, slots=True)
class DriveData:
    """Data of a joint's drive from a description; zero if not given."""

    armature: float  # rotor inertia reflected to the joint [kg.m^2]
    damping: float  # [N.m.s/rad]
    frictionloss: float  # [N.m]


@dataclass(frozen=True, slots=True)
class Description:
    """Robot description before any repair."""

    robot: ET.Element  # the ``<robot>`` element of a URDF
    drives: Mapping[str, DriveData] = field(default_factory=dict)  # by joint; a URDF has none
    findings: tuple[Finding, ...] = ()


def named(kind: str, names: Iterable[str]) -> str:
    """Text that lists one or several joints or links by name."""
    listed = list(names)
    return f"{kind}{'s' if len(listed) > 1 else ''} " + ", ".join(f"'{name}'" for name in listed)


def found(severity: Severity, kind: str, names: Iterable[str], fault: str, remedy: str) -> list[Finding]:
    """One finding about several joints or links; an empty list without names."""
    listed = list(dict.fromkeys(names))
    return [Finding(severity, named(kind, listed), fault, remedy)] if listed else []


def numbers(text: str | None, default: tuple[float, ...]) -> Vector:
    """Numbers of an attribute; the default if it is absent or malformed."""
    try:
        values = [float(item) for item in (text or "").split()]
    except ValueError:
        values = []
    usable = len(values) == len(default) and all(math.isfinite(value) for value in values)
    return np.array(values if usable else default)


def origin_of(element: ET.Element | None) -> tuple[Vector, Matrix]:
    """Position (3,) [m] and rotation (3, 3) of an <origin>; identity if it is absent."""
    xyz, rpy = (numbers(None if element is None else element.get(key), (0.0, 0.0, 0.0)) for key in ("xyz", "rpy"))
    return xyz, pin.rpy.rpyToMatrix(*rpy)


def links_by_name(robot: ET.Element) -> dict[str, ET.Element]:
    """Links of a robot, by name."""
    return {link.get("name", ""): link for link in robot.findall("link")}


def end(joint: ET.Element, role: str) -> str:
    """Name of a joint's 'parent' or 'child' link; empty if absent."""
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


def child(element: ET.Element, tag: str) -> ET.Element:
    """First child of an element with a tag; added if absent."""
    found = element.find(tag)
    return ET.SubElement(element, tag) if found is None else found


def masses(robot: ET.Element) -> dict[str, float]:
    """Mass of each link [kg]; 0 if absent."""
    result = {}
    for link in robot.findall("link"):
        mass = link.find("inertial/mass")
        result[link.get("name", "")] = 0.0 if mass is None else float(numbers(mass.get("value"), (0.0,))[0])
    return result


def links_below(robot: ET.Element, link: str) -> list[str]:
    """A link and all its descendants."""
    children: dict[str, list[str]] = {}
    for joint in robot.findall("joint"):
        children.setdefault(end(joint, "parent"), []).append(end(joint, "child"))
    found, waiting = [], [link]
    while waiting:
        name = waiting.pop()
        if name not in found:  # a URDF may contain a loop
            found.append(name)
            waiting += children.get(name, [])
    return found


def longest_chain(robot: ET.Element) -> float:
    """Length of the longest chain of joints, as the sum of the joint offsets [m]."""
    joints = {end(joint, "child"): joint for joint in robot.findall("joint")}

    def length(link: str) -> float:
        total, seen = 0.0, set[str]()
        while link in joints and link not in seen:
            seen.add(link)
            total += float(np.linalg.norm(origin_of(joints[link].find("origin"))[0]))
            link = end(joints[link], "parent")
        return total

    return max((length(link) for link in joints), default=0.0)


MISSING = (
    "mesh files are missing: a foot has the shape of the other meshes, and no clearance is kept from the missing ones"
)
_STL_HEAD, _STL_FACE = 84, 50  #: Sizes of the header and of a face of a binary STL file [bytes]
_STL_FACES = 200_000  #: Maximum faces of an STL file that MuJoCo accepts
_ROUND = 24  #: Points on the rim of a cylinder
_Y_UP = b"<up_axis>Y_UP"
_HEADER = 20000  #: Leading part of a Collada file that contains its <asset> [bytes]
_FLAT = 1e-12  #: Volume below which MuJoCo treats a mesh as a surface [m^3]


def repair_meshes(robot: ET.Element, urdf: Path, packages: Sequence[Path]) -> tuple[list[Finding], bool]:
    """Resolve mesh paths in place, replace meshes that MuJoCo cannot read, and drop missing or unreadable ones.

    Pinocchio ignores the up axis of Collada meshes with y up; the origin of such a shape is rotated by 90 deg. A visual
    mesh that MuJoCo cannot read becomes its bounding box. So does such an STL of a collision shape, because a link
    without visual shapes is drawn by its collision shapes. Other collision shapes are kept if Pinocchio reads them.
    Paths are relative to ``urdf``; ``package://`` is searched in ``packages`` first. Returns the findings, and whether
    a shape was changed or dropped.
    """
    boxed: dict[str, list[str]] = {}
    dropped: dict[str, list[str]] = {}
    shells: list[str] = []
    lying: list[str] = []
    missing: list[str] = []
    for link in robot.findall("link"):
        name = link.get("name", "")
        for shape in (*link.findall("visual"), *link.findall("collision")):
            mesh = shape.find("geometry/mesh")
            if mesh is None:
                continue
            file = resolve_uri(mesh.get("filename", ""), urdf.parent, packages)
            if not file.is_file():
                link.remove(shape)
                missing.append(name)
                continue
            mesh.set("filename", str(file))
            vertices, volume = _mesh(str(file))
            suffix = file.suffix.lower()
            if suffix == ".dae" and _Y_UP in file.read_bytes()[:_HEADER]:
                _raise(shape)
                lying.append(name)
            if vertices is None:
                link.remove(shape)
                dropped.setdefault(suffix, []).append(name)
            elif (shape.tag == "visual" or suffix == ".stl") and not _drawable(file):
                _box(shape, vertices * _scale(mesh))
                boxed.setdefault(suffix, []).append(name)
            elif shape.tag == "visual" and volume < _FLAT:
                shells.append(name)
    remedy = "left out; give the folder of their package with --package-dir"
    findings = found("wrong", "link", missing, MISSING, remedy)
    for suffix, names in dropped.items():
        findings += found("note", "link", names, f"{suffix} meshes cannot be read", "dropped")
    for suffix, names in boxed.items():
        text = f"{suffix} meshes that MuJoCo cannot read"
        findings += found("note", "link", names, text, "drawn as boxes of their bounds")
    text = "Collada meshes with y up, which Pinocchio does not rotate"
    findings += found("note", "link", lying, text, "rotated to z up")
    findings += found("note", "link", shells, "meshes without volume", "drawn as shells")
    return findings, bool(boxed or dropped or lying or missing)


def _drawable(file: Path) -> bool:
    """Whether MuJoCo reads a mesh: OBJ, and binary STL that is not too large."""
    if file.suffix.lower() != ".stl":
        return file.suffix.lower() == ".obj"
    with file.open("rb") as stream:
        faces = int.from_bytes(stream.read(_STL_HEAD)[-4:], "little")
    return 0 < faces <= _STL_FACES and file.stat().st_size == _STL_HEAD + faces * _STL_FACE


def link_points(link: ET.Element, upright: Matrix) -> Matrix:
    """Points (n, 3) [m] in the link's frame that span the hull of the link's shapes, as seen from below; n may be 0.

    ``upright`` is the rotation (3, 3) of the link in an upright frame; a sphere gives its six extreme points along the
    upright axes. Visual shapes are used if no collision shape gives a point. Mesh paths must be absolute.
    """
    for kind in ("collision", "visual"):
        clouds = [_placed(shape, upright) for shape in link.findall(kind)]
        clouds = [cloud for cloud in clouds if len(cloud)]
        if clouds:
            return np.vstack(clouds)
    return np.zeros((0, 3))


def _placed(shape: ET.Element, upright: Matrix) -> Matrix:
    xyz, rotation = origin_of(shape.find("origin"))
    geometry = shape.find("geometry")
    sphere = None if geometry is None else geometry.find("sphere")
    if sphere is not None:
        tips = np.vstack([np.eye(3), -np.eye(3)]) @ upright  # rows: the upright axes in the link's frame
        return np.asarray(xyz + float(numbers(sphere.get("radius"), (0.0,))[0]) * tips)
    return np.asarray(_own_points(geometry) @ rotation.T + xyz)


def _own_points(geometry: ET.Element | None) -> Matrix:
    """Points (n, 3) [m] of a box, a cylinder or a mesh in the frame of the shape."""
    nothing = np.zeros((0, 3))
    if geometry is None:
        return nothing
    box, cylinder, mesh = (geometry.find(tag) for tag in ("box", "cylinder", "mesh"))
    if box is not None:
        half = 0.5 * numbers(box.get("size"), (0.0, 0.0, 0.0))
        return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    if cylinder is not None:
        radius, length = (float(numbers(cylinder.get(key), (0.0,))[0]) for key in ("radius", "length"))
        angles = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)
        rim = radius * np.column_stack([np.cos(angles), np.sin(angles)])
        return np.vstack([np.column_stack([rim, np.full(_ROUND, z)]) for z in (-0.5 * length, 0.5 * length)])
    if mesh is not None:
        vertices, _ = _mesh(mesh.get("filename", ""))
        return nothing if vertices is None else vertices * _scale(mesh)
    return nothing


def _scale(mesh: ET.Element) -> Matrix:
    return numbers(mesh.get("scale"), (1.0, 1.0, 1.0))


@lru_cache(maxsize=512)
def _mesh(file: str) -> tuple[Matrix | None, float]:
    """Vertices (n, 3) [m] and volume [m^3] of a mesh file; None and 0 if it cannot be read."""
    try:
        mesh = coal.MeshLoader().load(file, np.ones(3))
        return np.array(mesh.vertices()), abs(float(mesh.computeVolume()))
    except Exception:  # coal raises several types without a common base
        return None, 0.0


def _raise(shape: ET.Element) -> None:
    """Rotate a shape by 90 deg about its x axis, so that its y axis points up."""
    turned = origin_of(shape.find("origin"))[1] @ pin.rpy.rpyToMatrix(0.5 * np.pi, 0.0, 0.0)
    text = " ".join(f"{value:.9g}" for value in pin.rpy.matrixToRpy(turned))
    child(shape, "origin").set("rpy", text)


def _box(shape: ET.Element, vertices: Matrix) -> None:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    xyz, rotation = origin_of(shape.find("origin"))
    centre = xyz + rotation @ (0.5 * (low + high))
    child(shape, "origin").set("xyz", " ".join(f"{value:.6g}" for value in centre))
    geometry = shape.find("geometry")
    if geometry is not None:
        for each in list(geometry):
            geometry.remove(each)
        size = np.maximum(high - low, 1e-4)  # a planar mesh becomes a box 0.1 mm thick
        ET.SubElement(geometry, "box", size=" ".join(f"{value:.6g}" for value in size))
