"""Inertias that no body can have: replaced by the mirror image of the partner's, else by those of a solid."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin

from models.pinocchio_urdf import possible
from models.proposal.findings import Finding, named
from models.proposal.shapes import link_points
from models.proposal.skeleton import BASE, Skeleton
from models.proposal.tree import masses, numbers
from models.types import Matrix

_MIRROR = np.diag([1.0, -1.0, 1.0])
_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

_DIGITS = 12
"""Digits that count of an inertia in a message; less is the rounding of whoever printed a zero."""

_DENSITY = 1000.0
"""Of a body without shapes, as a solid ball [kg/m^3]."""

_SPREAD = 0.5
"""Radius of gyration, over the leg's length, beyond which an inertia is a placeholder rather than a body's [-]."""


def repair_inertias(robot: ET.Element, skeleton: Skeleton) -> list[Finding]:
    """Replace in place the inertia of links that no body can have; mass and centre of mass stay.

    MuJoCo asks every link with mass for a possible inertia, also one that is welded to others.

    Args:
        robot: The ``<robot>`` element.
        skeleton: Its joints, built without a check of its bodies.

    Returns:
        What was replaced.
    """
    elements = {link.get("name", ""): link for link in robot.findall("link")}
    weights = masses(robot)
    findings = []
    usable = {name for name, link in elements.items() if weights[name] > 0.0 and possible(_inertia(link))}
    for joint in range(BASE, skeleton.model.njoints):
        links = [link for link in skeleton.links(joint) if weights[link] > 0.0]
        twins = [link for link in skeleton.links(skeleton.partners.get(joint, joint)) if weights[link] > 0.0]
        whole = possible(skeleton.model.inertias[joint].inertia)
        for i, link in enumerate(links):
            if link in usable or (whole and not _inertia(elements[link]).any()):
                continue  # a point that is welded to a body is no fault
            moments = np.linalg.eigvalsh(_inertia(elements[link]).round(_DIGITS)) + 0.0  # no -0
            fault = "impossible inertia: principal moments " + ", ".join(f"{value:.3g}" for value in moments)
            if len(twins) == len(links) and twins[i] in usable:
                ratio = weights[link] / weights[twins[i]]
                twin, own = (_rotation(elements[name], skeleton, name) for name in (twins[i], link))
                image = own.T @ _MIRROR @ twin
                inertia = ratio * image @ _inertia(elements[twins[i]]) @ image.T
                remedy = f"the mirror image of link '{twins[i]}' taken"
            else:
                inertia = _solid(elements[link], weights[link])
                remedy = "that of a solid of its mass and bounds taken"
            _write(elements[link], inertia)
            findings.append(Finding("note" if whole else "wrong", f"link '{link}'", f"{fault} kg.m^2", remedy))
    return findings


def placeholders(skeleton: Skeleton, length: float) -> list[Finding]:
    """Bodies whose inertia would need a mass spread wider than their robot; ``length`` is that of a leg [m]."""
    wide = []
    for j in range(BASE, skeleton.model.njoints):
        inertia = skeleton.model.inertias[j]
        radius = float(np.sqrt(np.linalg.eigvalsh(inertia.inertia)[0] / inertia.mass))
        if radius > _SPREAD * length:
            wide.append(skeleton.links(j)[0])
    if not wide:
        return []
    text = f"inertia of a body more than {1e3 * length:.0f} mm across: a placeholder"
    return [Finding("wrong", named("link", wide), text, "kept: the robot is slower to turn than it looks")]


def _inertia(link: ET.Element) -> Matrix:
    """Inertia about the centre of mass, in the axes of <inertial> (3, 3) [kg.m^2]."""
    element = link.find("inertial/inertia")
    xx, xy, xz, yy, yz, zz = (float(numbers(None if element is None else element.get(key), (0.0,))[0]) for key in _KEYS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _rotation(link: ET.Element, skeleton: Skeleton, name: str) -> Matrix:
    """Axes of <inertial> in the base at zero (3, 3)."""
    origin = link.find("inertial/origin")
    rpy = numbers(None if origin is None else origin.get("rpy"), (0.0, 0.0, 0.0))
    return np.asarray(skeleton.place(name).rotation @ pin.rpy.rpyToMatrix(*rpy))


def _solid(link: ET.Element, mass: float) -> Matrix:
    """Inertia of the box of the link's bounds, or of a ball where it has no shapes (3, 3) [kg.m^2]."""
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
