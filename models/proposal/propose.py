"""From a URDF to a profile: read, repair, find, and put together."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from models.config import default_config
from models.pinocchio_urdf import pinocchio_from_element
from models.profile import Feet, Profile, Sensors, Sole, load_profile
from models.proposal.config import ProposalConfig
from models.proposal.drives import propose_drives
from models.proposal.findings import Finding
from models.proposal.hulls import propose_hulls
from models.proposal.inertias import placeholders, repair_inertias
from models.proposal.legs import Legs, asymmetries, find_legs, named_left
from models.proposal.limbs import find_limbs
from models.proposal.posture import PostureSolver
from models.proposal.repair import BASE_LINK, rename_links, repair_joints
from models.proposal.shapes import repair_meshes
from models.proposal.skeleton import BASE, Skeleton
from models.proposal.soles import SoleShape, find_sole, foot_points
from models.proposal.tree import end
from models.urdf import parse_urdf

FORWARD = "base_forward"
"""Link put above a base that looks backward."""

_EQUAL = 0.02
"""Limits of partners that differ by less count as equal [rad], [-]."""

_PATTERN = "g1"
"""Packaged robot whose sensors a proposal takes."""

_PATTERN_MASS = 33.3
"""Its mass [kg]."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A profile as found, and all that was found on the way.

    Attributes:
        source: The URDF that was read.
        profile: The profile; its ``urdf`` is the one that was read, or the name of a file for ``robot`` next to it.
        robot: The changed URDF where the given one had to be changed; None where it is used as it is.
        findings: What is missing or wrong.
        pairs: Names of the joints that mirror each other, left and right.
        mass: Total mass [kg].
        com_height: Height of the CoM above the soles in the posture 'stand' [m].
        leg_length: From hip to ankle along the leg [m].
    """

    source: Path
    profile: Profile
    robot: ET.Element | None
    findings: tuple[Finding, ...]
    pairs: tuple[tuple[str, str], ...]
    mass: float
    com_height: float
    leg_length: float


def propose(urdf: Path, packages: Sequence[Path] = (), config: ProposalConfig | None = None) -> Proposal:
    """Propose a profile for a robot of which nothing but its URDF is known.

    Args:
        urdf: The URDF.
        packages: Folders in which ``package://`` is looked for first.
        config: What is assumed; the packaged one when None.

    Raises:
        RobotModelError: The URDF is unusable: not XML, a mesh is missing, a moving body has no mass, it has no feet;
            file, joint or link, and cause are named.
    """
    urdf = urdf.expanduser().resolve()
    config = config or default_config(ProposalConfig, "models", "proposal")
    robot = parse_urdf(urdf)
    findings = [*repair_joints(robot, config.repair), *rename_links(robot)]
    changed = bool(findings) or bool(packages)
    found, replaced = repair_meshes(robot, urdf, [folder.expanduser().resolve() for folder in packages])
    findings += found
    inertias = repair_inertias(robot, Skeleton(pinocchio_from_element(robot, urdf, bodies=False), config.sole.mirror))
    findings += inertias
    changed |= replaced or bool(inertias)
    skeleton = Skeleton(pinocchio_from_element(robot, urdf), config.sole.mirror)
    legs = find_legs(skeleton, urdf)
    if _backward(robot, skeleton, legs, config.sole.lopsided, findings):
        _turn_round(robot)
        changed = True
        skeleton = Skeleton(pinocchio_from_element(robot, urdf), config.sole.mirror)
        legs = find_legs(skeleton, urdf)
    findings += [*asymmetries(skeleton, _EQUAL), *placeholders(skeleton, skeleton.reach(list(legs.left)))]
    left = find_sole(robot, skeleton, legs.left, config.sole, urdf)
    soles = left, find_sole(robot, skeleton, legs.right, config.sole, urdf)
    findings += [finding for sole in soles for finding in sole.findings]
    floor = float((skeleton.place(left.link) * left.placement).translation[2])
    limbs = find_limbs(robot, skeleton, legs, floor)
    standing = PostureSolver(skeleton, legs, soles, config.posture).solve(limbs.arms)
    motors, joints, sticky = propose_drives(skeleton, standing.com_height, config.drive)
    findings += [*limbs.findings, *standing.findings, *sticky]
    mass = float(pin.computeTotalMass(skeleton.model))
    profile = Profile(
        name=_robot_name(robot, urdf),
        urdf=f"{urdf.stem}_repaired.urdf" if changed else str(urdf),
        base_link=_root(robot),
        motors=motors,
        joints=joints,
        feet=Feet(left=_sole(soles[0]), right=_sole(soles[1]), friction=config.sole.friction),
        frames=limbs.frames,
        postures={"stand": standing.joints},
        sensors=_sensors(mass),
        hulls=propose_hulls(robot, skeleton, legs, limbs),
    )
    names = skeleton.name
    pairs = tuple((names(j), names(k)) for j, k in skeleton.partners.items() if j != k and _is_left(skeleton, j, k))
    return Proposal(
        urdf,
        profile,
        robot if changed else None,
        tuple(findings),
        pairs,
        mass,
        standing.com_height,
        skeleton.reach(list(legs.left)),
    )


def _is_left(skeleton: Skeleton, joint: int, other: int) -> bool:
    return bool(skeleton.origins[joint][1] > skeleton.origins[other][1])


def _root(robot: ET.Element) -> str:
    children = {end(joint, "child") for joint in robot.findall("joint")}
    return next(name for link in robot.findall("link") if (name := link.get("name", "")) not in children)


def _robot_name(robot: ET.Element, urdf: Path) -> str:
    name = re.sub(r"[^a-z0-9]+", "_", (robot.get("name") or urdf.stem).lower()).strip("_")
    return name if name[:1].isalpha() else f"robot_{name}".rstrip("_")


def _backward(robot: ET.Element, skeleton: Skeleton, legs: Legs, lopsided: float, findings: list[Finding]) -> bool:
    """Whether the base's x axis points backward: by the names left and right, else by the toes."""
    points = foot_points(robot, skeleton, legs.left[-1])
    ahead, behind = (float(points[:, 0].max()), -float(points[:, 0].min())) if len(points) else (0.0, 0.0)
    toes = None if not max(ahead, behind) > lopsided * min(ahead, behind) else ahead > behind
    left = named_left(skeleton, legs)
    base = f"link '{skeleton.links(BASE)[0]}'"
    if left is not None and toes is not None and left is not toes:
        text = f"the names say that left is at {'+' if left else '-'}y, the feet are longer to the other end"
        findings.append(Finding("wrong", base, text, "the names are believed"))
    forward = left if left is not None else toes
    if forward is False:
        text = "the base's x axis points backward (REP-103: x forward, y left)"
        findings.append(Finding("note", base, text, f"turned round below a new base '{FORWARD}'"))
    return forward is False


def _turn_round(robot: ET.Element) -> None:
    """Put a new base above the old one, half a turn about z away, in place; it alone may be called base_link."""
    old = _root(robot)
    for link in robot.findall("link"):
        if link.get("name") == old == BASE_LINK:
            old = f"{BASE_LINK}_backward"
            link.set("name", old)
    for joint in robot.findall("joint"):
        parent = joint.find("parent")
        if parent is not None and parent.get("link") == BASE_LINK:
            parent.set("link", old)
    robot.append(ET.Element("link", name=FORWARD))
    joint = ET.SubElement(robot, "joint", name=f"{FORWARD}_joint", type="fixed")
    ET.SubElement(joint, "parent", link=FORWARD)
    ET.SubElement(joint, "child", link=old)
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy=f"0 0 {np.pi:.17g}")


def _sole(shape: SoleShape) -> Sole:
    x, y, z = (round(float(value), 4) + 0.0 for value in shape.placement.translation)
    roll, pitch, yaw = (round(float(a), 6) + 0.0 for a in pin.rpy.matrixToRpy(shape.placement.rotation))
    return Sole(link=shape.link, xyz=(x, y, z), rpy=(roll, pitch, yaw), rectangle=shape.rectangle)


def _sensors(mass: float) -> Sensors:
    """The sensors of the G1 but for scanner and camera, those of the feet grown or shrunk with the robot's weight."""
    pattern = load_profile(_PATTERN)
    sensors = pattern.sensors
    ratio = mass / _PATTERN_MASS
    weighed = [f"{kind}_{what}" for kind in ("force", "torque") for what in ("noise", "offset", "range", "resolution")]
    feet: dict[str, Any] = {key: float(f"{ratio * getattr(sensors.feet, key):.2g}") for key in weighed}
    return replace(sensors, feet=replace(sensors.feet, **feet), scan=None, camera=None)
