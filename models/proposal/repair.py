"""Joints of a URDF that the loader would refuse: made usable where that is safe, and every change told."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from models.constants import GRAVITY
from models.profile import REQUIRED_FRAMES, RESERVED_FRAMES
from models.proposal.config import RepairConfig
from models.proposal.findings import Finding, named
from models.proposal.tree import end, links_below, longest_chain, masses, numbers

BASE_LINK = "base_link"
"""Name of REP-105 for the base: that of the root of many robots."""

_UNSUPPORTED = ("prismatic", "planar")


def repair_joints(robot: ET.Element, config: RepairConfig) -> list[Finding]:
    """Change joints in place so that ``models.urdf.check_urdf`` has no cause left to refuse them.

    Mimic, prismatic and planar joints are fixed at zero; so is a joint without torque that moves next to nothing, such
    as a finger. Any other joint without limits gets estimates. A floating joint at the root goes, with its massless
    parent, since the loader adds the base itself.

    Args:
        robot: The ``<robot>`` element.
        config: What is assumed.

    Returns:
        What was changed; empty when nothing was.
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
            _limit(joint).attrib.pop(key, None)
    findings += _fill_torque(robot, config)
    findings += _fill(robot, "velocity", config.velocity, "rad/s")
    findings += _fill_range(robot, config.range)
    return findings


def rename_links(robot: ET.Element) -> list[Finding]:
    """Give links another name in place that are called like a frame which the profile defines; a root may be base_link.

    /tf would have two frames of one name, and MuJoCo two bodies.
    """
    children = {end(joint, "child") for joint in robot.findall("joint")}
    links = {link.get("name", ""): link for link in robot.findall("link")}
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
    if not renamed:
        return []
    return [Finding("note", named("link", renamed), "named like a frame of the profile", "renamed: _link is appended")]


def _moving(robot: ET.Element) -> list[ET.Element]:
    return [joint for joint in robot.findall("joint") if joint.get("type") != "fixed"]


def _names(joints: list[ET.Element]) -> str:
    return named("joint", [joint.get("name", "") for joint in joints])


def _limit(joint: ET.Element) -> ET.Element:
    limit = joint.find("limit")
    return ET.SubElement(joint, "limit") if limit is None else limit


def _value(joint: ET.Element, key: str) -> float:
    limit = joint.find("limit")
    return 0.0 if limit is None else float(numbers(limit.get(key), (0.0,))[0])


def _unfloat(robot: ET.Element) -> list[Finding]:
    findings = []
    weights = masses(robot)
    for joint in robot.findall("joint"):
        parent = end(joint, "parent")
        siblings = [other for other in robot.findall("joint") if end(other, "parent") == parent]
        if joint.get("type") != "floating" or len(siblings) != 1 or weights.get(parent, 0.0) > 0.0:
            continue
        robot.remove(joint)
        for link in [link for link in robot.findall("link") if link.get("name") == parent]:
            robot.remove(link)
        findings.append(Finding("note", _names([joint]), "is floating", f"removed with link '{parent}'"))
    return findings


def _fix(joints: list[ET.Element], fault: str) -> list[Finding]:
    if not joints:
        return []
    for joint in joints:
        joint.set("type", "fixed")
        for tag in ("mimic", "limit", "dynamics", "axis", "safety_controller", "calibration"):
            for element in joint.findall(tag):
                joint.remove(element)
    return [Finding("note", _names(joints), fault, "fixed at zero")]


def _fill_torque(robot: ET.Element, config: RepairConfig) -> list[Finding]:
    """Torque limits: missing ones are estimated, unless the joint moves so little that it is better fixed."""
    without = [joint for joint in _moving(robot) if _value(joint, "effort") <= 0.0]
    weights = masses(robot)
    mass = sum(weights.values())
    light = [j for j in without if sum(weights[n] for n in links_below(robot, end(j, "child"))) < config.light * mass]
    findings = _fix(light, "no torque limit, and next to nothing to move")
    heavy = [joint for joint in without if joint not in light]
    torque = float(f"{config.torque * mass * GRAVITY * longest_chain(robot):.3g}")
    for joint in heavy:
        _limit(joint).set("effort", f"{torque:g}")
    if heavy:
        remedy = f"{torque:g} N.m assumed, a guess by mass and size: set torque_limit"
        findings.append(Finding("wrong", _names(heavy), "no torque limit (effort missing or zero)", remedy))
    return findings


def _fill(robot: ET.Element, key: str, value: float, unit: str) -> list[Finding]:
    without = [joint for joint in _moving(robot) if _value(joint, key) <= 0.0]
    for joint in without:
        _limit(joint).set(key, f"{value:g}")
    if not without:
        return []
    return [Finding("wrong", _names(without), f"no {key} limit", f"{value:g} {unit} assumed: set {key}_limit")]


def _fill_range(robot: ET.Element, reach: float) -> list[Finding]:
    without = [joint for joint in _moving(robot) if not _value(joint, "lower") < _value(joint, "upper")]
    for joint in without:
        _limit(joint).set("lower", f"{-reach:g}")
        _limit(joint).set("upper", f"{reach:g}")
    if not without:
        return []
    return [Finding("wrong", _names(without), "no position limits", f"{reach:g} rad to both sides assumed")]
