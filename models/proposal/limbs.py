"""Torso, hands, head and inertial unit: which links carry the frames that every profile names."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from models.profile import Frame
from models.proposal.findings import Finding
from models.proposal.legs import Legs
from models.proposal.shapes import link_points
from models.proposal.skeleton import BASE, Skeleton

_CAMERA = re.compile(r"camera|rgbd|realsense|d435|zed|gaze|eye", re.IGNORECASE)
_HEAD = re.compile(r"head|face", re.IGNORECASE)
_IMU = re.compile(r"imu|gyro|accelero|inertial_unit", re.IGNORECASE)

_IMU_REACH = 0.5
"""How far from the base an inertial unit may be, over the leg's length [-]."""

_HEAD_ABOVE = 1.2
"""Height of a head that no link shows, over that of the shoulders above the soles."""


@dataclass(frozen=True, slots=True)
class Limbs:
    """What is not a leg.

    Attributes:
        arms: Joints of the left and the right arm from shoulder to hand; empty without arms.
        torso: Joint that moves the torso; ``BASE`` where it is the base.
        frames: The profile's frames.
        findings: What could not be found.
    """

    arms: tuple[tuple[int, ...], tuple[int, ...]]
    torso: int
    frames: dict[str, Frame]
    findings: tuple[Finding, ...]


def find_limbs(robot: ET.Element, skeleton: Skeleton, legs: Legs, floor: float) -> Limbs:
    """Find arms, torso, head and inertial unit.

    Args:
        robot: The ``<robot>`` element.
        skeleton: Its joints.
        legs: Its legs.
        floor: Height of the soles in the base at zero [m].
    """
    findings: list[Finding] = []
    left = _arm(skeleton, legs)
    arms = left, tuple(skeleton.partners[j] for j in left)
    torso = _trunk(skeleton, left)
    frames = {"torso": Frame(link=skeleton.links(torso)[0])}
    if not left:
        text = "no arms: no two mirrored chains of joints outside the legs"
        findings.append(
            Finding("wrong", f"link '{skeleton.links(BASE)[0]}'", text, "l_wrist and r_wrist placed on the torso")
        )
    shoulder = skeleton.origins[left[0]][2] if left else skeleton.origins[torso][2]
    frames["gaze"] = _gaze(robot, skeleton, torso, floor + _HEAD_ABOVE * (float(shoulder) - floor), findings)
    for name, chain in zip(("l_wrist", "r_wrist"), arms, strict=True):
        frames[name] = Frame(link=skeleton.links(chain[-1] if chain else torso)[0])
    frames["imu"] = _imu(skeleton, torso, skeleton.reach(list(legs.left)), findings)
    return Limbs(arms, torso, frames, tuple(findings))


def _arm(skeleton: Skeleton, legs: Legs) -> tuple[int, ...]:
    """The left one of the two mirrored chains with the longest reach, up to where the fingers branch off."""
    shoulders = [
        j
        for j, other in skeleton.partners.items()
        if j != other
        and j not in legs.left
        and skeleton.origins[j][1] > skeleton.origins[other][1]
        and (skeleton.model.parents[j] == BASE or skeleton.central(int(skeleton.model.parents[j])))
    ]
    chains = []
    for joint in shoulders:
        chain = [joint]
        while len(skeleton.children[chain[-1]]) == 1 and skeleton.children[chain[-1]][0] in skeleton.partners:
            chain.append(skeleton.children[chain[-1]][0])
        chains.append(tuple(chain))
    return max(chains, key=lambda chain: skeleton.reach(list(chain)), default=())


def _trunk(skeleton: Skeleton, arm: tuple[int, ...]) -> int:
    """Joint that the arms hang from; without arms the last of the middle joints."""
    if arm:
        return int(skeleton.model.parents[arm[0]])
    joint = BASE
    while central := [j for j in skeleton.children[joint] if skeleton.central(j)]:
        joint = central[0]
    return joint


def _gaze(robot: ET.Element, skeleton: Skeleton, torso: int, height: float, findings: list[Finding]) -> Frame:
    """A camera, else a link called head, else the top of what the torso carries; it looks ahead."""
    upper = [
        link
        for joint in skeleton.below(torso)
        if joint == torso or _middle(skeleton, joint)
        for link in skeleton.links(joint)
    ]
    for pattern in (_CAMERA, _HEAD):
        matches = [link for link in upper if pattern.search(link)]
        if matches:
            return level(skeleton, max(matches, key=lambda link: float(skeleton.place(link).translation[2])))
    elements = {link.get("name", ""): link for link in robot.findall("link")}
    tops = {}
    for link in upper:
        place = skeleton.place(link)
        points = link_points(elements[link], place.rotation) @ place.rotation.T + place.translation
        tops[link] = float(points[:, 2].max()) if len(points) else float(place.translation[2])
    link = max(tops, key=lambda name: tops[name])
    place = skeleton.place(link)
    top = max(tops[link], height)
    findings.append(Finding("note", f"link '{link}'", "no link is called head or camera", "gaze placed on top of it"))
    lift = place.actInv(np.array([place.translation[0], 0.0, top]))
    return level(skeleton, link, (round(float(lift[0]), 4), round(float(lift[1]), 4), round(float(lift[2]), 4)))


def _middle(skeleton: Skeleton, joint: int) -> bool:
    """Whether a joint and all that carry it are in the middle: neck and head."""
    return all(skeleton.central(j) for j in skeleton.chain(joint))


def _imu(skeleton: Skeleton, torso: int, leg: float, findings: list[Finding]) -> Frame:
    """A link called imu on the base, or on the torso near it, in the axes of the base; else the base."""
    base = skeleton.links(BASE)[0]
    for link in (link for joint in (BASE, torso) for link in skeleton.links(joint)):
        if not _IMU.search(link):
            continue
        away = float(np.linalg.norm(skeleton.place(link).translation))
        if away < _IMU_REACH * leg:
            return level(skeleton, link)
        text = f"an inertial unit {1e3 * away:.0f} mm from the base: joint noise times that lever is velocity noise"
        findings.append(Finding("note", f"link '{link}'", text, f"placed in link '{base}' instead"))
        return level(skeleton, base)
    findings.append(Finding("note", f"link '{base}'", "no link is called imu", "the inertial unit is placed here"))
    return level(skeleton, base)


def level(skeleton: Skeleton, link: str, xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Frame:
    """A frame on a link with the axes of the base at zero."""
    angles = pin.rpy.matrixToRpy(skeleton.place(link).rotation.T)
    roll, pitch, yaw = (round(float(angle), 6) + 0.0 for angle in angles)
    return Frame(link=link, xyz=xyz, rpy=(roll, pitch, yaw))
