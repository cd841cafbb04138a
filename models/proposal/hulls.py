"""Coarse hulls of pelvis, torso, head, thighs and hands, so that a fallen robot lies on the simulated floor."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from models.profile import Hull
from models.proposal.legs import Legs
from models.proposal.limbs import Limbs
from models.proposal.shapes import link_points
from models.proposal.skeleton import BASE, Skeleton

_LEAST = 0.02
"""Bodies thinner than this get no hull [m]."""


def propose_hulls(robot: ET.Element, skeleton: Skeleton, legs: Legs, limbs: Limbs) -> dict[str, Hull]:
    """Capsules within the bounds of the links that hit the floor first."""
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
    elements = {link.get("name", ""): link for link in robot.findall("link")}
    hulls = {}
    for part, joint in parts.items():
        for link in skeleton.links(joint):
            points = link_points(elements[link], np.eye(3))
            if len(points) and (hull := _capsule(link, points.min(axis=0), points.max(axis=0))) is not None:
                hulls[part] = hull
                break
    return hulls


def _capsule(link: str, low: np.ndarray, high: np.ndarray) -> Hull | None:
    """Capsule along the longest side of a box (3,), (3,) [m], as thick as its thinner other side."""
    size = high - low
    longest = int(size.argmax())
    radius = 0.5 * float(np.delete(size, longest).min())
    if radius < _LEAST:
        return None
    ends = np.array([0.5 * (low + high)] * 2)
    ends[:, longest] += np.array([-1.0, 1.0]) * (0.5 * size[longest] - radius)
    (x1, y1, z1), (x2, y2, z2) = np.round(ends, 3).tolist()
    return Hull(link=link, start=(x1, y1, z1), end=(x2, y2, z2), radius=round(radius, 3))
