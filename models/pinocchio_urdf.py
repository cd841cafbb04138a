"""Pinocchio's model of a URDF, checked for bodies that cannot be simulated."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

from models.errors import RobotModelError
from models.types import Matrix
from models.urdf import check_urdf, read_urdf


def pinocchio_from_urdf(urdf: Path) -> pin.Model:
    """Check a URDF and build its Pinocchio model with a free-flying base.

    Raises:
        RobotModelError: The URDF is unusable (see ``read_urdf``), or a moving body has no mass or an impossible
            inertia; file, joint or link, and cause are named.
    """
    read_urdf(urdf)
    return _checked(lambda: pin.buildModelFromUrdf(str(urdf), pin.JointModelFreeFlyer()), urdf)


def pinocchio_from_element(robot: ET.Element, urdf: Path, *, bodies: bool = True) -> pin.Model:
    """The same for a ``<robot>`` element; ``urdf`` names it in an error, and ``bodies`` is whether they are checked."""
    check_urdf(robot, urdf)
    text = ET.tostring(robot, encoding="unicode")
    return _checked(lambda: pin.buildModelFromXML(text, pin.JointModelFreeFlyer()), urdf, bodies=bodies)


def possible(inertia: Matrix) -> bool:
    """Whether a body with mass could have this inertia about its centre of mass (3, 3) [kg.m^2]."""
    low, middle, high = np.linalg.eigvalsh(inertia)
    return bool(low > 0.0 and low + middle >= high * (1.0 - 1e-6))  # 1e-6: rounding of printed inertias


def _checked(build: Callable[[], pin.Model], urdf: Path, *, bodies: bool = True) -> pin.Model:
    try:
        model = build()
    except Exception as error:  # Pinocchio raises several kinds, none of them narrower
        raise RobotModelError(f"{urdf}: Pinocchio refuses it: {error}") from error
    if bodies:
        _check_bodies(model, urdf)
    return model


def _check_bodies(model: pin.Model, urdf: Path) -> None:
    for joint, inertia in zip(list(model.names)[1:], list(model.inertias)[1:], strict=True):
        where = f"{urdf}: the body moved by joint '{joint}'" if joint != "root_joint" else f"{urdf}: the base"
        if inertia.mass <= 0.0:
            raise RobotModelError(f"{where} has no mass")
        if not possible(inertia.inertia):
            low, middle, high = np.linalg.eigvalsh(inertia.inertia)
            moments = f"{low:.3g}, {middle:.3g}, {high:.3g} kg.m^2"
            raise RobotModelError(f"{where} has an impossible inertia: principal moments {moments}")
