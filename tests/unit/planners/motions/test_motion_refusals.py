"""What the motion planner refuses, and that it names the culprit; each bound is also violated on purpose."""

from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest

from models.config import default_config
from models.errors import CommandError, UnreachableError
from models.robot_model import RobotModel
from models.trajectory import validate_trajectory
from models.types import Vector
from planners.collision import SelfCollision
from planners.goals import plant, stand_on
from planners.key_pose import KeyPoseSolver
from planners.motion import JointCurve, MotionPlanner, check_path
from planners.motion_config import MotionConfig
from planners.whole_body_ik import Bounds, WholeBodyIk
from tests.motions import load


def place(model: RobotModel, frame: str) -> Vector:
    """Origin of a frame in base_footprint in 'stand' (3,) [m]."""
    data = model.data()
    plant(model, data, model.posture("stand"))
    return np.array(data.oMf[model.frame_id(frame)].translation)


class TestRequests:
    def test_unknown_motion_lists_the_known(self) -> None:
        model, planner = load("g1")
        with pytest.raises(CommandError, match=r"'dance'.*bow, crouch, reach, squat, stand, wave"):
            planner.plan("dance", model.posture("stand"))

    @pytest.mark.parametrize("joint", ["left_knee_joint", "right_ankle_pitch_joint"])
    def test_stand_alone_brings_back_legs_that_were_moved_against_each_other(self, joint: str) -> None:
        model, planner = load("g1")
        start = model.posture("stand").copy()
        start[model.joint_index(joint)] += 0.4
        for request in (partial(planner.plan, "wave"), partial(planner.plan_pose, "l_wrist", [0.3, 0.2, 0.9])):
            with pytest.raises(UnreachableError, match=r"off the mean plane .* send 'stand' first"):
                request(start_q=start)
        back = planner.plan("stand", start)
        assert back.positions[0] == pytest.approx(start) and back.positions[-1] == pytest.approx(model.posture("stand"))
        assert back.velocities is not None and not back.velocities[[0, -1]].any()
        validate_trajectory(back, model, start_q=start)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(SelfCollision, "distances", lambda *args: next(distances))
            distances = iter([np.full(planner._collision.count, gap) for gap in (0.05, 0.001)])
            with pytest.raises(UnreachableError, match="would collide"):
                planner.plan("stand", start)

    def test_frame_that_is_not_settable(self) -> None:
        model, planner = load("g1")
        with pytest.raises(CommandError, match="reach: 'l_wrist' cannot be set; these can: r_wrist"):
            planner.plan("reach", model.posture("stand"), targets={"l_wrist": [0.3, 0.2, 0.9]})
        with pytest.raises(CommandError, match="wave: 'r_wrist' cannot be set; these can: none"):
            planner.plan("wave", model.posture("stand"), targets={"r_wrist": [0.3, -0.2, 0.9]})

    @pytest.mark.parametrize("frame", ("l_sole", "nose"))
    def test_frame_that_cannot_be_moved(self, frame: str) -> None:
        model, planner = load("g1")
        with pytest.raises(CommandError, match=f"'{frame}' cannot be moved; these can: base_link"):
            planner.plan_pose(frame, [0.0, 0.0, 0.0], start_q=model.posture("stand"))

    @pytest.mark.parametrize(
        ("position", "orientation", "duration", "message"),
        [
            ([0.3, np.nan, 0.9], None, None, "position: nan"),
            ([0.3, 0.9], None, None, "position: expected 3 numbers"),
            (["a", 0.0, 0.0], None, None, "position: not numbers"),
            (None, [0.0, 0.0, 0.0, 2.0], None, "orientation: the quaternion has length 2"),
            (None, None, None, "give a position"),
            ([0.3, -0.2, 0.9], None, -1.0, "duration: -1.0"),
            ([0.3, -0.2, 0.9], None, np.nan, "duration: nan"),
            ([0.3, -0.2, 0.9], None, 1e6, "duration: 1000000.0"),
        ],
    )
    def test_malformed_pose(self, position: object, orientation: object, duration: float | None, message: str) -> None:
        model, planner = load("g1")
        with pytest.raises(CommandError, match=message):
            planner.plan_pose(
                "r_wrist",
                position,  # type: ignore[arg-type]
                orientation,  # type: ignore[arg-type]
                start_q=model.posture("stand"),
                duration=duration,
            )

    def test_start_of_wrong_size_or_not_finite(self) -> None:
        model, planner = load("g1")
        with pytest.raises(CommandError, match="start_q: expected 29 numbers"):
            planner.plan("wave", np.zeros(28))
        with pytest.raises(CommandError, match="start_q: inf"):
            planner.plan("wave", np.full(model.nj, np.inf))


class TestTargets:
    @pytest.mark.parametrize("robot", ("g1", "talos"))
    def test_far_away(self, robot: str) -> None:
        model, planner = load(robot)
        with pytest.raises(UnreachableError, match=r"r_wrist missed by \d\.\d+ m; stopped because joint") as refusal:
            planner.plan("reach", model.posture("stand"), targets={"r_wrist": [3.0, 0.0, 1.0]})
        assert "reach, key pose 'there'" in str(refusal.value)

    @pytest.mark.parametrize("robot", ("g1", "talos"))
    def test_pelvis_higher_than_the_legs_are_long(self, robot: str) -> None:
        model, planner = load(robot)
        knee = {"g1": "left_knee_joint", "talos": "leg_left_4_joint"}[robot]
        with pytest.raises(UnreachableError, match=f"base_link missed by .* joint '{knee}' is at its lower limit"):
            planner.plan_pose(
                "base_link", place(model, "base_link") + np.array([0, 0, 0.3]), start_q=model.posture("stand")
            )

    def test_com_would_leave_the_soles(self) -> None:
        model, planner = load("g1")
        with pytest.raises(UnreachableError, match=r"the CoM is at the support polygon's margin of 0\.020 m"):
            planner.plan_pose(
                "base_link", place(model, "base_link") + np.array([0.2, 0, 0]), start_q=model.posture("stand")
            )

    @pytest.mark.parametrize(("robot", "torso"), (("g1", "torso_link"), ("talos", "torso_2_link")))
    def test_hand_inside_the_chest(self, robot: str, torso: str) -> None:
        model, planner = load(robot)
        target = place(model, "torso") + 0.1 * place(model, "gaze")[2] * np.array([0.0, 0.0, 1.0])
        with pytest.raises(UnreachableError, match=f"bodies would collide: .*{torso}"):
            planner.plan_pose("r_wrist", target, start_q=model.posture("stand"))

    def test_orientation_beyond_the_joints(self) -> None:
        model, planner = load("talos")
        data = model.data()
        plant(model, data, model.posture("stand"))
        behind = pin.rpy.rpyToMatrix(0.0, 0.0, 3.1) @ data.oMf[model.frame_id("gaze")].rotation
        with pytest.raises(UnreachableError, match=r"orientation of gaze missed by .*'head_2_joint' is at its upper"):
            planner.plan_pose("gaze", None, pin.Quaternion(behind).coeffs(), start_q=model.posture("stand"))

    @pytest.mark.parametrize("robot", ("g1", "talos"))
    def test_reachable_target_is_reached(self, robot: str) -> None:
        model, planner = load(robot)
        target = place(model, "r_wrist") + np.array([0.2, 0.0, 0.25])
        data = model.data()
        plan = planner.plan("reach", model.posture("stand"), targets={"r_wrist": target})
        hand = []
        for joints in plan.positions:
            plant(model, data, joints)
            hand.append(data.oMf[model.frame_id("r_wrist")].translation.copy())
        assert np.linalg.norm(hand - target, axis=1).min() < 0.004

    def test_orientation_is_reached_and_held(self) -> None:
        model, planner = load("g1")
        data = model.data()
        plant(model, data, model.posture("stand"))
        expected = pin.rpy.rpyToMatrix(0.0, 0.3, 0.2) @ data.oMf[model.frame_id("torso")].rotation
        plan = planner.plan_pose(
            "torso", None, pin.Quaternion(expected).coeffs(), start_q=model.posture("stand"), duration=2.5
        )
        plant(model, data, plan.positions[-1])
        assert np.linalg.norm(pin.log3(data.oMf[model.frame_id("torso")].rotation.T @ expected)) < 0.02
        assert plan.times[-1] == pytest.approx(2.5)

    def test_solver_keeps_bodies_apart_where_the_plain_solution_would_not(self) -> None:
        model, planner = load("g1")
        config = default_config(MotionConfig, "planners", "motion")
        target = place(model, "base_link") + 0.12 * place(model, "gaze")[2] * np.array([1.0, 0.0, 0.8])
        planner.plan_pose("r_wrist", target, start_q=model.posture("stand"))
        blind = MotionPlanner(model, replace(config, solver=replace(config.solver, rounds=2)))
        blind._keys._near = lambda q, bounds: set()  # type: ignore[method-assign]
        blind._ik._set_pairs = lambda pairs: None  # type: ignore[method-assign]
        with pytest.raises(UnreachableError, match="bodies would collide"):
            blind.plan_pose("r_wrist", target, start_q=model.posture("stand"))


class TestStarts:
    def test_joint_outside_its_limits(self) -> None:
        model, planner = load("g1")
        q = model.posture("stand").copy()
        elbow = model.joint_index("left_elbow_joint")
        q[elbow] = model.q_upper[elbow] + 0.2
        with pytest.raises(UnreachableError, match=r"start posture: joint 'left_elbow_joint' at .* is outside"):
            planner.plan("stand", q)

    def test_joint_slightly_outside_is_clipped(self) -> None:
        model, planner = load("g1")
        q = model.posture("stand").copy()
        elbow = model.joint_index("left_elbow_joint")
        q[elbow] = model.q_upper[elbow] + 0.01
        plan = planner.plan("stand", q)
        assert plan.positions[0, elbow] == model.q_upper[elbow]
        assert plan.positions[:, elbow].max() <= model.q_upper[elbow]

    def test_com_outside_the_soles(self) -> None:
        model, planner = load("g1")
        q = model.posture("stand").copy()
        for side in ("left", "right"):
            q[model.joint_index(f"{side}_ankle_pitch_joint")] += 0.35
        with pytest.raises(UnreachableError, match=r"start posture: the CoM is -?0\.\d+ m inside the support polygon"):
            planner.plan("stand", q)

    def test_com_inside_the_margin_may_come_back(self) -> None:
        model, planner = load("g1")
        data = model.data()
        q = model.posture("stand").copy()
        for side in ("left", "right"):
            q[model.joint_index(f"{side}_ankle_pitch_joint")] += 0.105
        stance = stand_on(model, data, q)
        assert 0.005 < stance.margin(stance.com) < 0.02
        plan = planner.plan("stand", q)
        end = stand_on(model, data, plan.positions[-1])
        assert end.margin(end.com) > 0.05

    def test_one_foot_in_the_air(self) -> None:
        model, planner = load("talos")
        q = model.posture("stand").copy()
        q[model.joint_index("leg_left_4_joint")] += 0.5
        with pytest.raises(UnreachableError, match="start posture: the left sole is"):
            planner.plan("wave", q)

    def test_bodies_inside_the_margin_at_the_start_may_part(self) -> None:
        model, planner = load("g1")
        q = model.posture("stand").copy()
        q[model.joint_index("left_shoulder_roll_joint")] = 0.08  # the hand nearly touches the thigh
        collision = SelfCollision(model, default_config(MotionConfig, "planners", "motion").collision)
        stance = stand_on(model, model.data(), q)
        assert collision.distances(stance.q, 0.1).min() < 0.005
        plan = planner.plan("stand", q)
        end = stand_on(model, model.data(), plan.positions[-1])
        assert collision.distances(end.q, 0.1).min() > 0.01


class TestPathCheck:
    """The last check refuses each kind of violation by itself."""

    def setup_method(self) -> None:
        self.model = load("g1")[0]
        self.config = default_config(MotionConfig, "planners", "motion")
        self.collision = SelfCollision(self.model, self.config.collision)
        ik = WholeBodyIk(self.model, self.config, self.collision)
        keys = KeyPoseSolver(self.model, self.config, self.collision, ik)
        self.stance = stand_on(self.model, self.model.data(), self.model.posture("stand"))
        self.bounds = keys.bounds(self.stance)

    def check(self, bounds: Bounds | None = None, **changes: float) -> None:
        """Check a curve that moves joints from 'stand' by the given amounts."""
        end = self.model.posture("stand").copy()
        for joint, change in changes.items():
            end[self.model.joint_index(f"{joint}_joint")] += change
        s = np.linspace(0.0, 1.0, 101)[:, None]
        q = (1.0 - s) * self.model.posture("stand") + s * end
        curve = JointCurve(s[:, 0], q, np.zeros_like(q), np.zeros_like(q))
        check_path(self.model, self.config, self.collision, self.stance, bounds or self.bounds, curve)

    def test_standing_still_passes(self) -> None:
        self.check()

    def test_joint_limit(self) -> None:
        with pytest.raises(UnreachableError, match=r"joint 'right_elbow_joint' would be at .* outside"):
            self.check(right_elbow=2.0)

    def test_sliding_soles(self) -> None:
        with pytest.raises(UnreachableError, match=r"after 0\.\d+ s the relative motion of the soles would be"):
            self.check(left_hip_roll=0.1)

    def test_com(self) -> None:
        tight = replace(self.bounds, com_margin=self.stance.margin(self.stance.com))
        with pytest.raises(UnreachableError, match=r"the CoM would be .* inside the support polygon, at least"):
            self.check(tight, right_shoulder_pitch=-1.5)

    def test_tilt_of_the_base(self) -> None:
        turn = {"left_hip_pitch": -0.1, "right_hip_pitch": -0.1}
        self.check(**turn)
        with pytest.raises(UnreachableError, match=r"the base would tilt by 0.\d+ rad, at most 0.05 rad"):
            self.check(replace(self.bounds, base_tilt=0.05), **turn)

    def test_collision(self) -> None:
        with pytest.raises(UnreachableError, match="right_hip_roll_link and right_wrist_yaw_link' would collide"):
            self.check(right_shoulder_roll=0.4)
