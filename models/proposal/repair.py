"""Repair of a URDF that the loader would refuse: joints, names of links, and impossible inertias."""

import xml.etree.ElementTree as ET

import numpy as np

from models.constants import GRAVITY
from models.profile import REQUIRED_FRAMES, RESERVED_FRAMES
from models.proposal.config import RepairConfig
from models.proposal.shapes import (
    Finding,
    child,
    end,
    found,
    link_points,
    links_below,
    links_by_name,
    longest_chain,
    masses,
    numbers,
    origin_of,
)
from models.proposal.skeleton import BASE, Skeleton
from models.types import Matrix
from models.urdf import possible

BASE_LINK = "base_link"  #: Name of the base in REP-105; also the root link of many robots
_UNSUPPORTED = ("prismatic", "planar")


def repair_joints(robot: ET.Element, config: RepairConfig) -> list[Finding]:
    """Change joints in place so that ``models.urdf.check_urdf`` accepts them; returns the changes.

    Mimic, prismatic and planar joints are fixed at zero, as are joints that move no mass, and joints without torque
    limit that move very little mass, such as fingers. Other joints without limits get estimates. A floating joint at
    the root is removed with its massless parent, because the loader adds the floating base.
    """
    findings = _unfloat(robot)
    mimics = [joint for joint in _moving(robot) if joint.find("mimic") is not None]
    findings += _fix(mimics, "follow another joint (mimic)")
    for kind in _UNSUPPORTED:
        joints = [joint for joint in robot.findall("joint") if joint.get("type") == kind]
        findings += _fix(joints, f"of type {kind}, which the laws do not move")
    continuous = [joint for joint in robot.findall("joint") if joint.get("type") == "continuous"]
    for joint in continuous:
        joint.set("type", "revolute")
        for key in ("lower", "upper"):
            child(joint, "limit").attrib.pop(key, None)
    weights = masses(robot)
    idle = [joint for joint in _moving(robot) if not any(weights[n] for n in links_below(robot, end(joint, "child")))]
    findings += _fix(idle, "no link below it has mass")
    findings += _fill_torque(robot, config)
    joints = [joint for joint in _moving(robot) if _value(joint, "velocity") <= 0.0]
    remedy = f"{config.velocity:g} rad/s assumed: set velocity_limit"
    findings += _assume(joints, {"velocity": config.velocity}, "no velocity limit", remedy)
    joints = [joint for joint in _moving(robot) if not _value(joint, "lower") < _value(joint, "upper")]
    limits = {"lower": -config.range, "upper": config.range}
    findings += _assume(joints, limits, "no position limits", f"{config.range:g} rad to both sides assumed")
    return findings


def rename_links(robot: ET.Element) -> list[Finding]:
    """Rename links with the name of a frame of the profile; /tf and MuJoCo require unique names."""
    children = {end(joint, "child") for joint in robot.findall("joint")}
    links = links_by_name(robot)
    renamed = {}
    for name in (*REQUIRED_FRAMES, *RESERVED_FRAMES):
        if name not in links or (name == BASE_LINK and name not in children):
            continue
        renamed[name] = f"{name}_link"
        while renamed[name] in links:
            renamed[name] += "_"
        links[name].set("name", renamed[name])
    for joint in robot.findall("joint"):
        for role in ("parent", "child"):
            element = joint.find(role)
            if element is not None and element.get("link") in renamed:
                element.set("link", renamed[element.get("link", "")])
    return found("note", "link", renamed, "named like a frame of the profile", "renamed: _link is appended")


def _moving(robot: ET.Element) -> list[ET.Element]:
    return [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]


def _names(joints: list[ET.Element]) -> list[str]:
    return [joint.get("name", "") for joint in joints]


def _value(joint: ET.Element, key: str) -> float:
    limit = joint.find("limit")
    return 0.0 if limit is None else float(numbers(limit.get(key), (0.0,))[0])


def _unfloat(robot: ET.Element) -> list[Finding]:
    findings: list[Finding] = []
    weights = masses(robot)
    for joint in robot.findall("joint"):
        parent = end(joint, "parent")
        siblings = [other for other in robot.findall("joint") if end(other, "parent") == parent]
        if joint.get("type") != "floating" or len(siblings) != 1 or weights.get(parent, 0.0) > 0.0:
            continue
        robot.remove(joint)
        for link in [link for link in robot.findall("link") if link.get("name") == parent]:
            robot.remove(link)
        findings += found("note", "joint", _names([joint]), "is floating", f"removed with link '{parent}'")
    return findings


def _fix(joints: list[ET.Element], fault: str) -> list[Finding]:
    for joint in joints:
        joint.set("type", "fixed")
        for tag in ("mimic", "limit", "dynamics", "axis", "safety_controller", "calibration"):
            for element in joint.findall(tag):
                joint.remove(element)
    return found("note", "joint", _names(joints), fault, "fixed at zero")


def _fill_torque(robot: ET.Element, config: RepairConfig) -> list[Finding]:
    """Estimate missing torque limits; fix joints that move very little mass."""
    without = [joint for joint in _moving(robot) if _value(joint, "effort") <= 0.0]
    weights = masses(robot)
    mass = sum(weights.values())
    light = [j for j in without if sum(weights[n] for n in links_below(robot, end(j, "child"))) < config.light * mass]
    findings = _fix(light, "no torque limit, and almost no mass to move")
    heavy = [joint for joint in without if joint not in light]
    torque = float(f"{config.torque * mass * GRAVITY * longest_chain(robot):.3g}")
    remedy = f"{torque:g} N.m assumed, estimated from mass and size: set torque_limit"
    return findings + _assume(heavy, {"effort": torque}, "no torque limit (effort missing or zero)", remedy)


def _assume(joints: list[ET.Element], limits: dict[str, float], fault: str, remedy: str) -> list[Finding]:
    for joint in joints:
        for key, value in limits.items():
            child(joint, "limit").set(key, f"{value:g}")
    return found("wrong", "joint", _names(joints), fault, remedy)


_MIRROR = np.diag([1.0, -1.0, 1.0])
_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

_DIGITS = 12  #: Decimals of an inertia in a message; further ones are the rounding of a printed zero
_DENSITY = 1000.0  #: Density of a body without shapes, as a solid ball [kg/m^3]
#: Radius of gyration, over the leg's length, above which an inertia counts as a placeholder [-]
_SPREAD = 0.5


def repair_inertias(robot: ET.Element, skeleton: Skeleton) -> list[Finding]:
    """Replace physically impossible inertias, which MuJoCo refuses, and report them; mass and CoM are unchanged."""
    elements = links_by_name(robot)
    weights = masses(robot)
    findings = []
    usable = {name for name, link in elements.items() if weights[name] > 0.0 and possible(_inertia(link))}
    for joint in range(BASE, skeleton.model.njoints):
        links = [link for link in skeleton.links(joint) if weights[link] > 0.0]
        twins = [link for link in skeleton.links(skeleton.partners.get(joint, joint)) if weights[link] > 0.0]
        whole = possible(skeleton.model.inertias[joint].inertia)
        for i, link in enumerate(links):
            if link in usable or (whole and not _inertia(elements[link]).any()):
                continue  # a point mass fixed to a body is not a fault
            moments = np.linalg.eigvalsh(_inertia(elements[link]).round(_DIGITS)) + 0.0  # no -0
            fault = "impossible inertia: principal moments " + ", ".join(f"{value:.3g}" for value in moments)
            if len(twins) == len(links) and twins[i] in usable:
                ratio = weights[link] / weights[twins[i]]
                twin, own = (_rotation(elements[name], skeleton, name) for name in (twins[i], link))
                image = own.T @ _MIRROR @ twin
                inertia = ratio * image @ _inertia(elements[twins[i]]) @ image.T
                remedy = f"replaced by the mirror image of that of link '{twins[i]}'"
            else:
                inertia = _solid(elements[link], weights[link])
                remedy = "replaced by that of a solid with its mass and bounds"
            _write(elements[link], inertia)
            findings.append(Finding("note" if whole else "wrong", f"link '{link}'", f"{fault} kg.m^2", remedy))
    return findings


def placeholders(skeleton: Skeleton, length: float) -> list[Finding]:
    """Report bodies with an inertia too large for the robot's size; ``length`` is that of a leg [m]."""
    wide = []
    for j in range(BASE, skeleton.model.njoints):
        inertia = skeleton.model.inertias[j]
        radius = float(np.sqrt(np.linalg.eigvalsh(inertia.inertia)[0] / inertia.mass))
        if radius > _SPREAD * length:
            wide.append(skeleton.links(j)[0])
    text = f"inertia of a body more than {1e3 * length:.0f} mm across: a placeholder"
    return found("wrong", "link", wide, text, "kept: the robot rotates more slowly than its shape suggests")


def _inertia(link: ET.Element) -> Matrix:
    """Inertia (3, 3) about the centre of mass, in the axes of <inertial> [kg.m^2]."""
    element = link.find("inertial/inertia")
    xx, xy, xz, yy, yz, zz = (float(numbers(None if element is None else element.get(key), (0.0,))[0]) for key in _KEYS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _rotation(link: ET.Element, skeleton: Skeleton, name: str) -> Matrix:
    """Rotation (3, 3) of <inertial> in the base frame at zero."""
    return np.asarray(skeleton.place(name).rotation @ origin_of(link.find("inertial/origin"))[1])


def _solid(link: ET.Element, mass: float) -> Matrix:
    """Inertia (3, 3) of the link's bounding box, or of a ball if it has no shapes [kg.m^2]."""
    points = link_points(link, np.eye(3))
    if len(points):
        x, y, z = np.ptp(points, axis=0) ** 2
        return np.diag([y + z, x + z, x + y]) * mass / 12.0
    radius = float(np.cbrt(3.0 * mass / (4.0 * np.pi * _DENSITY)))
    return np.eye(3) * 0.4 * mass * radius**2


def _write(link: ET.Element, inertia: Matrix) -> None:
    element = link.find("inertial/inertia")
    if element is not None:
        rows, columns = np.triu_indices(3)
        for key, value in zip(_KEYS, inertia[rows, columns], strict=True):
            element.set(key, f"{value:.9g}")
