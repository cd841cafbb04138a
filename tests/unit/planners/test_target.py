"""Targets in frames of the robot and of the world."""

import numpy as np
import pinocchio as pin
import pytest

from models.errors import CommandError
from models.heading import base_footprint
from models.robot_model import RobotModel
from models.types import Vector
from planners.goals import frame_named, plant, planted_target

LEVEL = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture
def joints(g1: RobotModel) -> Vector:
    """A posture whose pelvis is turned against the soles."""
    q = np.array(g1.posture("stand"))
    for name in ("left_hip_yaw_joint", "right_hip_yaw_joint"):
        q[g1.joint_index(name)] += 0.1
    return q


def test_one_place_is_the_same_target_in_every_frame(g1: RobotModel, joints: Vector) -> None:
    data = g1.data()
    q, soles = plant(g1, data, joints)
    planted = pin.XYZQUATToSE3(q[:7])
    place = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.3, 0.2, 0.9]))
    base = np.array([1.0, 2.0, 0.7, *pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, 1.0)).coeffs()])
    footprint = planted * pin.XYZQUATToSE3(base_footprint(q[:7], np.array([sole.translation for sole in soles])))
    frames = {
        "odom": planted * pin.XYZQUATToSE3(base).inverse(),
        "base_footprint": footprint,
        "base_link": planted,
        "torso": data.oMf[g1.frame_id("torso")].copy(),
    }
    for name, frame in frames.items():
        given = frame.actInv(place)
        turn = pin.Quaternion(given.rotation).coeffs()
        target = planted_target(g1, joints, name, given.translation, turn, base)
        np.testing.assert_allclose(target.homogeneous, place.homogeneous, atol=1e-12)
    assert abs(pin.rpy.matrixToRpy(footprint.rotation)[2]) > 0.05  # turned with the pelvis, not with the soles


@pytest.mark.parametrize(
    ("frame", "place", "turn", "message"),
    [
        ("odom", (0.0, 0.0, 0.0), LEVEL, "no odometry was received"),
        ("map", (0.0, 0.0, 0.0), LEVEL, "unknown frame 'map'; known: odom, base_footprint, base_link"),
        ("", (0.0, 0.0, 0.0), LEVEL, "unknown frame ''"),
        ("base_link", (0.0, np.nan, 0.0), LEVEL, "target.pose.position: nan"),
        ("base_link", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0), "target.pose.orientation: the quaternion has length 0"),
    ],
)
def test_a_target_that_means_nothing_is_refused(
    g1: RobotModel, joints: Vector, frame: str, place: object, turn: object, message: str
) -> None:
    with pytest.raises(CommandError, match=message):
        planted_target(g1, joints, frame, place, turn, None)  # type: ignore[arg-type]


def test_frames_have_the_names_that_people_use() -> None:
    assert [frame_named(name) for name in ("left_hand", "head", "torso")] == ["l_wrist", "gaze", "torso"]
    with pytest.raises(CommandError, match="'tail' cannot be moved; these can: left_hand, right_hand, head, base_link"):
        frame_named("tail")
