"""The tree of links and joints of a URDF, by name, before it is known to be usable."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import numpy as np

from models.types import Vector


def numbers(text: str | None, default: tuple[float, ...]) -> Vector:
    """The numbers of an attribute; the default where it is absent or malformed."""
    try:
        values = [float(word) for word in (text or "").split()]
    except ValueError:
        values = []
    usable = len(values) == len(default) and all(math.isfinite(value) for value in values)
    return np.array(values if usable else default)


def end(joint: ET.Element, role: str) -> str:
    """Name of a joint's 'parent' or 'child' link; empty where it has none."""
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


def masses(robot: ET.Element) -> dict[str, float]:
    """Mass of each link [kg]; 0 where it has none."""
    result = {}
    for link in robot.findall("link"):
        mass = link.find("inertial/mass")
        result[link.get("name", "")] = 0.0 if mass is None else float(numbers(mass.get("value"), (0.0,))[0])
    return result


def links_below(robot: ET.Element, link: str) -> list[str]:
    """A link and all that hangs from it."""
    children: dict[str, list[str]] = {}
    for joint in robot.findall("joint"):
        children.setdefault(end(joint, "parent"), []).append(end(joint, "child"))
    found, waiting = [], [link]
    while waiting:
        name = waiting.pop()
        if name not in found:  # a URDF may hold a loop
            found.append(name)
            waiting += children.get(name, [])
    return found


def longest_chain(robot: ET.Element) -> float:
    """Length of the longest chain of joints, from offset to offset [m]."""
    joints = {end(joint, "child"): joint for joint in robot.findall("joint")}

    def length(link: str) -> float:
        total, seen = 0.0, set[str]()
        while link in joints and link not in seen:
            seen.add(link)
            origin = joints[link].find("origin")
            xyz = numbers(None if origin is None else origin.get("xyz"), (0.0, 0.0, 0.0))
            total += float(np.linalg.norm(xyz))
            link = end(joints[link], "parent")
        return total

    return max((length(link) for link in joints), default=0.0)
