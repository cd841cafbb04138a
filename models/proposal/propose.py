"""Proposal of a profile from a URDF or MJCF: read, repair, find limbs and soles, choose drives without maker data.

With mass m, CoM height h, gravity g and torque limit tau of a joint,

    armature = clip(a tau h / g, a_min m h^2, a_max m h^2)       kp = k sqrt(tau m g h)      kd = T sqrt(h / g) kp

so that robots of equal shape and different size behave alike: all terms scale correctly with mass and length.
a, k and T lie between the values of the G1 and of TALOS. kd is at most c I / dt, with the inertia I = 1 / (M^-1)_ii at
the joint and the tick dt of the driver; with a larger kd the sampled velocity loop of a light wrist oscillates.
Armature and friction of an MJCF file are kept.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from models.config import default_config
from models.constants import GRAVITY
from models.profile import Feet, Joint, Motor, Profile, Sensors, Sole, load_profile
from models.proposal.config import DriveConfig, ProposalConfig
from models.proposal.posture import PostureSolver
from models.proposal.repair import BASE_LINK, placeholders, rename_links, repair_inertias, repair_joints
from models.proposal.shapes import Description, DriveData, Finding, end, found, repair_meshes
from models.proposal.skeleton import BASE, Legs, Skeleton, asymmetries, find_legs, find_limbs, named_left
from models.proposal.soles import SoleShape, find_sole, foot_points, propose_hulls
from models.types import Vector
from models.urdf import parse_description, pinocchio_from_element


def propose_drives(
    skeleton: Skeleton, height: float, config: DriveConfig, given: Mapping[str, DriveData]
) -> tuple[dict[str, Motor], dict[str, Joint], list[Finding]]:
    """Motors and joints by name, from the CoM ``height`` [m] and ``given`` data; findings name implausible friction."""
    model = skeleton.model
    mass = float(pin.computeTotalMass(model))
    inertias = _joint_inertias(skeleton)
    motors: dict[str, Motor] = {}
    joints: dict[str, Joint] = {}
    implausible: list[str] = []
    for j in range(BASE + 1, model.njoints):
        v = int(model.joints[j].idx_v)
        twin, data = skeleton.partners.get(j, j), given.get(skeleton.name(j))
        alike = model.effortLimit[v] == model.effortLimit[int(model.joints[twin].idx_v)]
        if skeleton.name(twin) in joints and alike and data == given.get(skeleton.name(twin)):
            joints[skeleton.name(j)] = joints[skeleton.name(twin)]
            continue
        torque = float(model.effortLimit[v])
        weight = mass * GRAVITY * height
        effective = min(torque, weight)  # some URDFs state 1000 N.m in place of a limit
        armature = float(
            np.clip(
                config.armature_torque * effective * height / GRAVITY,
                config.armature_min * mass * height**2,
                config.armature_max * mass * height**2,
            )
        )
        armature = data.armature if data is not None and data.armature > 0.0 else _rounded(armature)
        decay = config.damping_time * np.sqrt(height / GRAVITY)
        stiffness = config.stiffness * np.sqrt(effective * weight)
        damping = min(decay * stiffness, config.damping_max * (float(inertias[v]) + armature) / config.tick)
        cap = config.friction * effective
        viscous, dry = float(model.damping[v]), float(model.friction[v])
        if viscous > cap or dry > cap:
            implausible.append(skeleton.name(j))
        friction = [_rounded(min(value, cap) if value > 0.0 else 0.5 * cap) for value in (viscous, dry)]
        if data is not None and (data.damping > 0.0 or data.frictionloss > 0.0):
            friction = [data.damping, data.frictionloss]
        motor = Motor(
            armature=armature,
            damping=friction[0],
            frictionloss=friction[1],
            torque_rate=_rounded(torque / config.rise),
            kp=_rounded(damping / decay),
            kd=_rounded(damping),
        )
        joints[skeleton.name(j)] = Joint(motor=_motor_name(motors, motor, torque))
    text = f"damping or friction above {100.0 * config.friction:g} % of the torque limit: implausible for a drive"
    return motors, joints, found("note", "joint", implausible, text, "reduced to this limit")


def _joint_inertias(skeleton: Skeleton) -> Vector:
    """Inertia at each velocity coordinate with all others free, without rotor inertia (nv,) [kg.m^2]."""
    model = skeleton.model
    data = model.createData()
    upper = np.triu(pin.crba(model, data, pin.neutral(model)))
    return np.asarray(1.0 / np.diag(np.linalg.inv(upper + np.triu(upper, 1).T)))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _motor_name(motors: dict[str, Motor], motor: Motor, torque: float) -> str:
    """Name of a motor; adds it to ``motors`` unless an equal one exists."""
    for name, known in motors.items():
        if known == motor:
            return name
    stem = name = f"drive_{torque:g}nm".replace(".", "p").replace("+", "")
    letter = ord("b")
    while name in motors:
        name = f"{stem}_{chr(letter)}"
        letter += 1
    motors[name] = motor
    return name


FORWARD = "base_forward"  #: New root link above a base whose x axis points backward
_EQUAL = 0.02  #: Maximum difference of equal limits of partners [rad], [-]
_PATTERN = "g1"  #: Packaged robot that provides the sensors of a proposal
_PATTERN_MASS = 33.3  #: Mass of that robot [kg]


@dataclass(frozen=True, slots=True)
class Proposal:
    """Proposed profile, and all findings."""

    source: Path  # the original URDF
    profile: Profile  # ``write_proposal`` sets ``urdf`` to the file that it writes for ``robot``
    robot: ET.Element | None  # repaired URDF; None if the original needs no repair
    findings: tuple[Finding, ...]  # missing or wrong parts
    pairs: tuple[tuple[str, str], ...]  # names of mirrored joints, left and right
    mass: float  # total [kg]
    com_height: float  # above the soles in the posture 'stand' [m]
    leg_length: float  # from hip to ankle along the leg [m]
    unmet: Finding | None = None  # why the robot cannot stand in 'stand'; also one of the findings


def propose(urdf: Path, packages: Sequence[Path] = (), config: ProposalConfig | None = None) -> Proposal:
    """Propose a profile from a URDF or MJCF; ``packages`` are searched for meshes. ``RobotModelError`` if unusable."""
    urdf = urdf.expanduser().resolve()
    config = config or default_config(ProposalConfig, "models", "proposal")
    source = _read(urdf)
    robot = source.robot
    findings = [*source.findings, *repair_joints(robot, config.repair), *rename_links(robot)]
    changed = bool(findings) or bool(packages) or bool(source.drives)
    mesh_findings, replaced = repair_meshes(robot, urdf, [folder.expanduser().resolve() for folder in packages])
    findings += mesh_findings
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
    motors, joints, friction = propose_drives(skeleton, standing.com_height, config.drive, source.drives)
    findings += [*limbs.findings, *standing.findings, *friction]
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
    name, y = skeleton.name, skeleton.origins[:, 1]
    pairs = tuple((name(j), name(k)) for j, k in skeleton.partners.items() if y[j] > y[k])
    return Proposal(
        urdf,
        profile,
        robot if changed else None,
        tuple(findings),
        pairs,
        mass,
        standing.com_height,
        skeleton.reach(list(legs.left)),
        standing.unmet,
    )


def _read(path: Path) -> Description:
    root = parse_description(path)
    if root.tag == "robot":
        return Description(root)
    from models.proposal.mjcf import read_mjcf  # imports mujoco, which the laws do not need

    return read_mjcf(path)


def _root(robot: ET.Element) -> str:
    children = {end(joint, "child") for joint in robot.findall("joint")}
    return next(name for link in robot.findall("link") if (name := link.get("name", "")) not in children)


def _robot_name(robot: ET.Element, urdf: Path) -> str:
    name = re.sub(r"[^a-z0-9]+", "_", (robot.get("name") or urdf.stem).lower()).strip("_")
    return name if name[:1].isalpha() else f"robot_{name}".rstrip("_")


def _backward(robot: ET.Element, skeleton: Skeleton, legs: Legs, lopsided: float, findings: list[Finding]) -> bool:
    """Whether the base's x axis points backward, from the names left and right, else from the toes."""
    points = foot_points(robot, skeleton, legs.left[-1])
    ahead, behind = (float(points[:, 0].max()), -float(points[:, 0].min())) if len(points) else (0.0, 0.0)
    toes = None if not max(ahead, behind) > lopsided * min(ahead, behind) else ahead > behind
    left = named_left(skeleton, legs)
    base = f"link '{skeleton.links(BASE)[0]}'"
    if left is not None and toes is not None and left is not toes:
        text = f"by the names, left is at {'+' if left else '-'}y; by the longer end of the feet, at the opposite side"
        findings.append(Finding("wrong", base, text, "the names are used"))
    forward = left if left is not None else toes
    if forward is False:
        text = "the base's x axis points backward (REP-103: x forward, y left)"
        findings.append(Finding("note", base, text, f"rotated by 180 deg below a new base '{FORWARD}'"))
    return forward is False


def _turn_round(robot: ET.Element) -> None:
    """Add in place a new base above the old one, rotated by 180 deg about z; renames an old base called base_link."""
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
    """Sensors of the G1 without scanner, cameras and lidar; data of the foot sensors are scaled by the mass."""
    pattern = load_profile(_PATTERN)
    sensors = pattern.sensors
    ratio = mass / _PATTERN_MASS
    weighed = [f"{kind}_{what}" for kind in ("force", "torque") for what in ("noise", "offset", "range", "resolution")]
    feet: dict[str, Any] = {key: float(f"{ratio * getattr(sensors.feet, key):.2g}") for key in weighed}
    return replace(sensors, feet=replace(sensors.feet, **feet), scan=None, camera=None, depth=None, lidar=None)
