"""Motions of robots whose limbs are not those of the packaged ones: they adapt, or are refused with the reason."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.stability.humanoids import Humanoid
from models.errors import UnreachableError
from models.proposal.profile_text import write_proposal
from models.proposal.propose import propose
from models.robot_model import RobotModel
from models.types import JointTrajectory, Matrix
from planners.goals import plant, tilt_of
from planners.motion import MotionPlanner

Build = Callable[[Humanoid], RobotModel]


@pytest.fixture
def build(tmp_path: Path) -> Build:
    """The robot with the profile that is proposed for it."""

    def _build(robot: Humanoid) -> RobotModel:
        urdf = robot.write(tmp_path / str(hash(robot)))
        return RobotModel.load(write_proposal(propose(urdf), urdf.with_suffix(".yaml"))[0])

    return _build


def path_of(model: RobotModel, frame: str, motion: JointTrajectory) -> Matrix:
    """Places of a frame in base_footprint along a motion (n, 3) [m]."""
    data, places = model.data(), []
    for joints in motion.positions:
        plant(model, data, joints)
        places.append(np.array(data.oMf[model.frame_id(frame)].translation))
    return np.array(places)


def test_short_arms_wave_less(build: Build) -> None:
    model = build(Humanoid(arm=0.3))
    planner, stand = MotionPlanner(model), model.posture("stand")
    motion, size = planner.plan_sized("wave", stand)
    assert 0.4 <= size < 1.0
    way = path_of(model, "r_wrist", motion)
    stature = model.data()
    plant(model, stature, stand)
    asked = 0.42 * stature.oMf[model.frame_id("gaze")].translation[2]
    assert (way[:, 2] - way[0, 2]).max() == pytest.approx(size * asked, abs=0.01)
    assert MotionPlanner(build(Humanoid())).plan_sized("wave", build(Humanoid()).posture("stand"))[1] == 1.0


def test_a_target_of_the_caller_is_not_reduced(build: Build) -> None:
    model = build(Humanoid(arm=0.3))
    with pytest.raises(UnreachableError, match="position of r_wrist missed"):
        MotionPlanner(model).plan("reach", model.posture("stand"), targets={"r_wrist": [0.9, -0.2, 1.0]})


def test_without_arms_a_wave_is_refused_and_the_rest_is_not(build: Build) -> None:
    model = build(Humanoid(arms=(), head=False))
    planner, stand = MotionPlanner(model), model.posture("stand")
    for motion in ("wave", "reach"):
        with pytest.raises(UnreachableError, match=f"{motion} moves r_wrist, and humanoid has no such arm"):
            planner.plan(motion, stand)
    assert planner.plan_sized("squat", stand)[1] == 1.0 and planner.plan_sized("bow", stand)[1] == 1.0


def test_a_left_arm_alone_waves_as_the_right_one_would(build: Build) -> None:
    left, right = (build(Humanoid(arms=(side,))) for side in ("left", "right"))
    assert left.profile.frames["r_wrist"].link == "trunk" and right.profile.frames["l_wrist"].link == "trunk"
    ways = [
        path_of(model, frame, MotionPlanner(model).plan("wave", model.posture("stand")))
        for model, frame in ((left, "l_wrist"), (right, "r_wrist"))
    ]
    assert ways[0].max(axis=0) - ways[0].min(axis=0) == pytest.approx(np.ptp(ways[1], axis=0), abs=2e-3)
    assert ways[0] * [1.0, -1.0, 1.0] == pytest.approx(ways[1], abs=2e-3)


def test_a_torso_that_does_not_pitch_bows_with_the_base(build: Build) -> None:
    model = build(Humanoid())
    motion = MotionPlanner(model).plan("bow", model.posture("stand"))
    data, lean = model.data(), []
    for joints in motion.positions:
        plant(model, data, joints)
        lean.append(pin.rpy.matrixToRpy(data.oMf[model.frame_id("torso")].rotation)[1])
    assert max(lean) == pytest.approx(0.49, abs=0.03)


@pytest.mark.parametrize("motion", ["squat", "bow", "wave"])
def test_soles_that_roll_stay_flat_in_a_motion(build: Build, motion: str) -> None:
    model = build(Humanoid(ankle_roll=False))
    planned, data = MotionPlanner(model).plan(motion, model.posture("stand")), model.data()
    for joints in planned.positions[::5]:
        for sole in plant(model, data, joints)[1]:
            assert np.linalg.norm(pin.log3(sole.rotation)) < 0.004 and abs(sole.translation[2]) < 1e-3


def test_a_forearm_below_the_last_joint_carries_the_hand(build: Build) -> None:
    model = build(Humanoid(arm_joints=4))
    assert model.profile.frames["r_wrist"].link == "right_elbow_link"
    assert model.profile.frames["r_wrist"].xyz == pytest.approx((0.0, 0.0, -0.2), abs=0.01)
    assert build(Humanoid(arm_joints=1)).profile.frames["r_wrist"].link == "right_shoulder_pitch_link"


def test_a_base_that_turns_with_the_torso_stays_below_the_tilt_of_a_fall(build: Build) -> None:
    model = build(Humanoid())
    motion, size = MotionPlanner(model).plan_sized("crouch", model.posture("stand"))
    data = model.data()
    tilt = max(tilt_of(plant(model, data, joints)[0]) for joints in motion.positions)
    assert 0.5 < size < 1.0 and 0.5 < tilt <= 0.65
