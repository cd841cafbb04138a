"""Legs that touch: by the shapes of the links, feet included."""

import numpy as np
import pytest

from benchmarks.stability.legs import LegContact
from models.robot_model import RobotModel
from models.types import Vector


def rolled(robot: RobotModel, angle: float) -> Vector:
    """Both legs inwards at the hips by an angle [rad]."""
    q = robot.standing_configuration()
    for i, name in enumerate(robot.joint_names):
        if "hip_roll" in name or name in ("leg_left_2_joint", "leg_right_2_joint"):
            q[7 + i] += -angle if "left" in name else angle
    return q


def test_legs_touch_where_their_links_meet(robot: RobotModel) -> None:
    legs = LegContact(robot)
    assert legs.find(robot.standing_configuration()) == ""
    assert legs.find(rolled(robot, 0.2)) != ""
    angles = np.linspace(0.0, 0.2, 21)
    touching = [bool(legs.find(rolled(robot, angle))) for angle in angles]
    assert touching == sorted(touching)  # once they touch, they go on doing so


def test_the_feet_of_the_g1_touch_with_their_sides(g1: RobotModel) -> None:
    """Their collision shapes in the URDF are four points each."""
    legs = LegContact(g1)
    both = legs.find(rolled(g1, 0.15)).split(" and ")
    assert both == ["left_ankle_roll_link", "right_ankle_roll_link"]


def test_a_crossed_leg_touches_the_other_or_passes_in_front(g1: RobotModel) -> None:
    legs, q = LegContact(g1), rolled(g1, 0.2)
    for joint, angle in (("left_hip_pitch_joint", -0.9), ("right_hip_pitch_joint", 0.5)):
        q[7 + g1.joint_names.index(joint)] += angle
    assert legs.find(q) == ""


@pytest.mark.parametrize("side", [0, 1])
def test_left_and_right_are_alike(g1: RobotModel, side: int) -> None:
    legs, q = LegContact(g1), g1.standing_configuration()
    name, sign = (("left", -1.0), ("right", 1.0))[side]
    q[7 + g1.joint_names.index(f"{name}_hip_roll_joint")] += sign * 0.3
    assert legs.find(q) != ""
