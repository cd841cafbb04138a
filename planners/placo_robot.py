"""placo's view of a RobotModel: the same joints, frames and limits, built from the same URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import placo

from models.errors import RobotModelError
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import Vector
from models.urdf import read_urdf
from planners.goals import TARGET_FRAMES

PREFIX = "motion/"
"""Put before REP-120 names in placo's model, where a link of the URDF may already have that name."""

_AGREEMENT = 1e-9
"""Largest difference between both models' frames and CoM [m]: rounding of printed numbers only."""


def placo_robot(model: RobotModel) -> placo.RobotWrapper:
    """Build placo's robot.

    Args:
        model: The robot; its REP-120 frames become frames named ``PREFIX`` + name.

    Returns:
        Robot without collision bodies, in the posture 'stand'.

    Raises:
        RobotModelError: placo does not read the URDF as Pinocchio does.
    """
    robot = placo.RobotWrapper("", placo.Flags.ignore_collisions, _kinematic_urdf(model))
    if tuple(robot.joint_names()) != model.joint_names:
        raise RobotModelError(f"{model.urdf}: placo orders the joints differently from Pinocchio")
    robot.state.q = model.standing_configuration()
    robot.update_kinematics()
    data = model.data()
    pin.framesForwardKinematics(model.pin, data, robot.state.q)
    gaps = {
        name: np.abs(robot.get_T_world_frame(PREFIX + name) - data.oMf[model.frame_id(name)].homogeneous).max()
        for name in (*SOLE_FRAMES, *TARGET_FRAMES)
    }
    gaps["CoM"] = np.abs(robot.com_world() - pin.centerOfMass(model.pin, data, robot.state.q)).max()
    for name, gap in gaps.items():
        if gap > _AGREEMENT:
            raise RobotModelError(f"{model.urdf}: placo and Pinocchio disagree on {name} by {gap:.3g}")
    return robot


def _kinematic_urdf(model: RobotModel) -> str:
    """The URDF without shapes, and with a link for each REP-120 frame."""
    root = read_urdf(model.urdf)
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    for name in (*SOLE_FRAMES, *TARGET_FRAMES):
        frame = model.pin.frames[model.frame_id(name)]
        parent = model.pin.frames[frame.parentFrame]
        placement = parent.placement.actInv(frame.placement)
        ET.SubElement(root, "link", name=PREFIX + name)
        joint = ET.SubElement(root, "joint", name=f"{PREFIX}{name}_joint", type="fixed")
        ET.SubElement(joint, "parent", link=parent.name)
        ET.SubElement(joint, "child", link=PREFIX + name)
        xyz, rpy = placement.translation, pin.rpy.matrixToRpy(placement.rotation)
        ET.SubElement(joint, "origin", xyz=printed(xyz), rpy=printed(rpy))
    return ET.tostring(root, encoding="unicode")


def printed(values: Vector) -> str:
    """Numbers as a URDF has them, exact to the last bit."""
    return " ".join(f"{value:.17g}" for value in values)
