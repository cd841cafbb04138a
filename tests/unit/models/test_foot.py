"""What a leg holds of its sole: freedoms by the rank of its Jacobian, and where its ankle holds the CoP."""

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.stability.humanoids import Humanoid
from models.errors import RobotModelError
from models.foot import LENGTH, WIDTH, AnkleJoint, bearing_area, leg_freedoms
from models.proposal.profile_text import write_proposal
from models.proposal.propose import propose
from models.robot_model import RobotModel

SOLE = (-0.1, 0.12, -0.04, 0.05)


def built(robot: Humanoid, folder: Path) -> RobotModel:
    return RobotModel.load(write_proposal(propose(robot.write(folder)), folder / "mine.yaml")[0])


@pytest.mark.parametrize(
    ("robot", "free"),
    [
        (Humanoid(), (False, False, False)),
        (Humanoid(waist_legs=True), (False, False, False)),
        (Humanoid(ankle_roll=False), (True, False, False)),
        (Humanoid(hip_yaw=False), (False, False, True)),
        (Humanoid(hip_yaw=False, ankle_roll=False), (True, False, True)),
    ],
)
def test_freedoms_are_those_that_the_leg_lacks(robot: Humanoid, free: tuple[bool, ...], tmp_path: Path) -> None:
    model = built(robot, tmp_path)
    assert [foot.free for foot in model.feet] == [free, free]
    ankles = [(joint.axis, joint.positive) for joint in model.feet[0].ankle]
    assert ankles == ([(WIDTH, True), (LENGTH, True)] if robot.ankle_roll else [(WIDTH, True)])


def test_packaged_robots_hold_their_soles(g1: RobotModel, talos: RobotModel) -> None:
    for foot in (*g1.feet, *talos.feet):
        assert foot.free == (False, False, False) and foot.bearing == foot.rectangle
        assert sorted(joint.axis for joint in foot.ankle) == [LENGTH, WIDTH]


def test_a_leg_that_cannot_shift_the_weight_is_refused(g1: RobotModel) -> None:
    """Six joints are enough only where they move the sole in six directions."""
    data = g1.data()
    pin.computeJointJacobians(g1.pin, data, g1.standing_configuration())
    pin.updateFramePlacements(g1.pin, data)
    columns = pin.getFrameJacobian(g1.pin, data, g1.feet[0].frame_id, pin.LOCAL)[:, g1.feet[0].joint_ids_v]
    assert leg_freedoms(columns, g1.leg_length) == (False, False, False)
    pitch = columns[:, np.abs(columns[4]) > 0.9]
    assert pitch.shape[1] == 3
    with pytest.raises(RobotModelError, match="6 joints, which move the base above a planted foot in 5 of 6"):
        leg_freedoms(np.hstack((pitch, pitch)), g1.leg_length)


@pytest.mark.parametrize("limit", [math.inf, 1e20])
def test_an_ankle_without_a_limit_holds_the_whole_sole(limit: float) -> None:
    assert area(limit, 100.0) == SOLE


def test_an_ankle_holds_its_torque_over_the_load() -> None:
    assert area(6.0, 100.0) == pytest.approx((-0.06, 0.06, -0.04, 0.05))
    assert area(6.0, 100.0, offset=0.02) == pytest.approx((-0.04, 0.08, -0.04, 0.05))


def test_an_ankle_that_holds_no_point_of_the_sole_bears_at_the_nearest() -> None:
    assert area(0.0, 100.0) == pytest.approx((0.0, 0.0, -0.04, 0.05))
    assert area(1.0, 100.0, offset=0.5) == pytest.approx((0.12, 0.12, -0.04, 0.05))


def area(limit: float, force: float, offset: float = 0.0) -> tuple[float, float, float, float]:
    """Bearing area of a sole with one pitch joint ``offset`` [m] ahead of its frame."""
    columns = np.array([[0.0, 0.0, offset, 0.0, 1.0, 0.0]]).T
    ankle = (AnkleJoint(0, WIDTH, True),)
    return bearing_area(SOLE, ankle, columns, np.zeros(1), np.full(1, limit), force, rolls=False)
