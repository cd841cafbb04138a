"""Every packaged motion on both robots: limits, rest, planted soles, balance, self-collision, smoothness."""

import xml.etree.ElementTree as ET
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from models.robot_model import RobotModel
from models.trajectory import TrajectorySampler, validate_trajectory
from models.types import JointTrajectory, Matrix, Vector
from models.urdf import data_folder
from planners.goals import plant, stand_on
from planners.motion import MotionPlanner
from tests.motions import load

SPLINE = 1e-4  #: Beyond the margin of a joint that moves along it, between two points [rad]
MOTIONS = ("bow", "crouch", "reach", "squat", "stand", "wave")
COM_MARGIN = 0.019  # [m]; the configured 20 mm, less the slack between key poses
JOINT_MARGIN = 0.02  # [rad]
ROBOTS = ("g1", "talos")


@cache
def crouched(robot: str) -> Vector:
    """A start posture far from 'stand', on planted soles: pelvis lower and forward, left hand up, torso turned."""
    model, planner = load(robot)
    frame = model.standing_configuration()
    data = model.data()
    pin.framesForwardKinematics(model.pin, data, frame)
    base = data.oMf[model.frame_id("base_link")].translation
    hand = data.oMf[model.frame_id("l_wrist")].translation
    low = planner.plan_pose("base_link", base * [1, 1, 0.95] + [0.01, 0.01, 0], start_q=model.posture("stand"))
    up = planner.plan_pose("l_wrist", hand + np.array([0.15, 0.05, 0.15]), start_q=low.positions[-1])
    return up.positions[-1]


@cache
def planned(robot: str, motion: str, start: str) -> tuple[JointTrajectory, Vector]:
    model, planner = load(robot)
    q = np.array(model.posture("stand")) if start == "stand" else crouched(robot)
    return planner.plan(motion, q), q


@cache
def fine(robot: str, motion: str, start: str, rate: float = 200.0) -> tuple[Vector, Matrix, Matrix, Matrix]:
    """The curve that the robot executes, sampled between the trajectory's own points."""
    model, _ = load(robot)
    trajectory, q = planned(robot, motion, start)
    sampler = TrajectorySampler(trajectory, model, q)
    times = np.arange(0.0, sampler.duration, 1.0 / rate)
    samples = [[x.copy() for x in sampler.sample(float(t))] for t in times]
    return times, *(np.array([sample[k] for sample in samples]) for k in range(3))


@cache
def raw_meshes(robot: str) -> tuple[pin.GeometryModel, pin.GeometryData]:
    """The URDF's own collision meshes, not their hulls; pairs of bodies more than two joints apart."""
    model, _ = load(robot)
    geometry = pin.buildGeomFromUrdf(
        model.pin, str(model.urdf), pin.GeometryType.COLLISION, package_dirs=[str(data_folder().parent)]
    )
    bodies = geometry.geometryObjects
    supports = [set(model.pin.supports[body.parentJoint]) for body in bodies]
    for i in range(len(bodies)):
        for j in range(i):
            if len(supports[i] ^ supports[j]) > 2:
                geometry.addCollisionPair(pin.CollisionPair(j, i))
    return geometry, geometry.createData()


every_motion = pytest.mark.parametrize("motion", MOTIONS)
every_robot = pytest.mark.parametrize("robot", ROBOTS)
every_start = pytest.mark.parametrize("start", ("stand", "crouched"))


@every_robot
def test_the_packaged_motions(robot: str) -> None:
    assert load(robot)[1].names == MOTIONS


@every_start
@every_motion
@every_robot
class TestEveryMotion:
    def test_is_a_valid_trajectory_from_rest_to_rest(self, robot: str, motion: str, start: str) -> None:
        model, _ = load(robot)
        trajectory, q = planned(robot, motion, start)
        validate_trajectory(trajectory, model, start_q=q)
        assert trajectory.joint_names == model.joint_names and trajectory.velocities is not None
        np.testing.assert_array_equal(trajectory.positions[0], q)
        assert not trajectory.velocities[0].any() and not trajectory.velocities[-1].any()
        assert trajectory.times[0] == 0.0
        assert 0.009 < np.diff(trajectory.times).min() and np.diff(trajectory.times).max() <= 0.0201

    def test_ends_standing_or_low(self, robot: str, motion: str, start: str) -> None:
        model, _ = load(robot)
        trajectory, _ = planned(robot, motion, start)
        if motion == "crouch":
            low, stand = (
                plant(model, model.data(), joints)[0][2]
                for joints in (trajectory.positions[-1], model.posture("stand"))
            )
            assert low == pytest.approx(0.5 * stand, abs=0.01)
            return
        # The crouch moves no sole, so all motions end in the very posture that the robot stands in.
        np.testing.assert_allclose(trajectory.positions[-1], model.posture("stand"), atol=1e-5)

    def test_keeps_off_the_limits(self, robot: str, motion: str, start: str) -> None:
        model, _ = load(robot)
        _, q, v, a = fine(robot, motion, start)
        ends = np.array([q[0], q[-1], model.posture("stand")])
        lower = np.minimum(model.q_lower + JOINT_MARGIN, ends.min(axis=0)) - SPLINE
        upper = np.maximum(model.q_upper - JOINT_MARGIN, ends.max(axis=0)) + SPLINE
        assert ((q >= lower) & (q <= upper)).all()
        assert (np.abs(v) / model.v_max).max() < 0.5
        assert np.abs(a).max() < 13.0

    def test_velocities_are_the_derivative_of_positions(self, robot: str, motion: str, start: str) -> None:
        times, q, v, _ = fine(robot, motion, start, rate=1000.0)
        slope = np.gradient(q, times, axis=0)[1:-1]
        np.testing.assert_allclose(v[1:-1], slope, atol=2e-3 + 1e-3 * np.abs(v).max())
        assert np.abs(np.diff(v, axis=0)).max() < 13.0 * 0.001 * 1.1  # no step in velocity

    def test_soles_stay_planted(self, robot: str, motion: str, start: str) -> None:
        model, _ = load(robot)
        data = model.data()
        _, q, _, _ = fine(robot, motion, start)
        relative = []
        for joints in q:
            _, (left, right) = plant(model, data, joints)
            relative.append(left.actInv(right))
        slips = [np.linalg.norm(pose.translation - relative[0].translation) for pose in relative]
        turns = [np.linalg.norm(pin.log3(relative[0].rotation.T @ pose.rotation)) for pose in relative]
        assert max(slips) < 1e-3
        assert max(turns) < np.deg2rad(0.5)

    def test_com_and_zmp_stay_over_the_soles(self, robot: str, motion: str, start: str) -> None:
        model, _ = load(robot)
        data = model.data()
        times, q, _, _ = fine(robot, motion, start, rate=100.0)
        stance = stand_on(model, data, q[0])
        full = [plant(model, data, joints)[0] for joints in q]
        dt = times[1]
        v = np.array([pin.difference(model.pin, a, b) / dt for a, b in pairwise(full)])
        for i in range(1, len(full) - 1):
            com = np.array(pin.centerOfMass(model.pin, data, full[i]))
            assert stance.margin(com) > COM_MARGIN
            pin.rnea(model.pin, data, full[i], 0.5 * (v[i - 1] + v[i]), (v[i] - v[i - 1]) / dt)
            wrench = data.oMi[1].act(data.f[1])  # what the floor has to give, about the world's origin
            assert wrench.linear[2] > 0.0
            zmp = np.array([-wrench.angular[1], wrench.angular[0]]) / wrench.linear[2]
            assert stance.margin(zmp) > 0.01

    def test_raw_meshes_never_touch(self, robot: str, motion: str, start: str) -> None:
        model, _ = load(robot)
        data = model.data()
        geometry, geometry_data = raw_meshes(robot)
        _, q, _, _ = fine(robot, motion, start, rate=5.0)
        for joints in q:
            full, _ = plant(model, data, joints)
            pin.computeCollisions(model.pin, data, geometry, geometry_data, full, False)
            touching = [
                geometry.geometryObjects[pair.first].name + " " + geometry.geometryObjects[pair.second].name
                for pair, result in zip(geometry.collisionPairs, geometry_data.collisionResults, strict=True)
                if result.isCollision()
            ]
            assert not touching


@every_robot
class TestWhatItLooksLike:
    def poses(self, robot: str, motion: str, frame: str) -> list[pin.SE3]:
        model, _ = load(robot)
        data = model.data()
        places = []
        for joints in planned(robot, motion, "stand")[0].positions:
            plant(model, data, joints)
            places.append(data.oMf[model.frame_id(frame)].copy())
        return places

    def test_squat_lowers_the_pelvis_by_12_to_15_percent(self, robot: str) -> None:
        heights = np.array([pose.translation[2] for pose in self.poses(robot, "squat", "base_link")])
        assert 0.12 < 1.0 - heights.min() / heights[0] < 0.15
        np.testing.assert_allclose(heights[-1], heights[0], atol=1e-4)

    def test_bow_pitches_the_torso_by_25_to_30_degrees(self, robot: str) -> None:
        poses = self.poses(robot, "bow", "torso")
        pitch = max(np.rad2deg(pin.rpy.matrixToRpy(pose.rotation @ poses[0].rotation.T)[1]) for pose in poses)
        assert 25.0 < pitch < 30.0

    def test_wave_swings_a_raised_hand(self, robot: str) -> None:
        hand = np.array([pose.translation for pose in self.poses(robot, "wave", "r_wrist")])
        gaze = self.poses(robot, "wave", "gaze")[0].translation
        raised = hand[hand[:, 2] > 0.9 * gaze[2]]
        assert len(raised) > 100  # beside the head for more than a second
        turns = np.flatnonzero(np.diff(np.sign(np.diff(raised[:, 1]))))
        assert len(turns) >= 4  # two full swings or more
        assert np.ptp(raised[:, 1]) > 0.08
        assert 4.0 <= planned(robot, "wave", "stand")[0].times[-1] <= 6.0

    def test_wave_leaves_the_other_arm_alone(self, robot: str) -> None:
        model, _ = load(robot)
        trajectory, q = planned(robot, "wave", "stand")
        joint = model.pin.frames[model.frame_id("l_wrist")].parentJoint
        arm = [int(model.pin.joints[j].idx_v) - 6 for j in list(model.pin.supports[joint])[-5:]]
        assert np.abs(trajectory.positions[:, arm] - q[arm]).max() < 0.02


def test_the_same_request_gives_the_same_bits() -> None:
    model, planner = load("g1")
    q = model.posture("stand")
    first = planner.plan("wave", q)
    planner.plan("squat", q)  # what was planned in between leaves no trace
    for again in (planner.plan("wave", q), MotionPlanner(model).plan("wave", q)):
        np.testing.assert_array_equal(again.positions, first.positions)
        np.testing.assert_array_equal(again.velocities, first.velocities)
        np.testing.assert_array_equal(again.times, first.times)


@every_robot
def test_left_and_right_hand_reach_alike(robot: str) -> None:
    model, planner = load(robot)
    data = model.data()
    plant(model, data, model.posture("stand"))
    target = data.oMf[model.frame_id("r_wrist")].translation + np.array([0.15, 0.05, 0.2])
    flip = np.array([1.0, -1.0, 1.0])
    ends = []
    for frame, mirror in (("r_wrist", np.ones(3)), ("l_wrist", flip)):
        plan = planner.plan_pose(frame, mirror * target, start_q=model.posture("stand"))
        plant(model, data, plan.positions[-1])
        places = [data.oMf[model.frame_id(name)].translation.copy() for name in ("base_link", "torso")]
        hands = {name: data.oMf[model.frame_id(name)].translation.copy() for name in ("r_wrist", "l_wrist")}
        order = ("r_wrist", "l_wrist") if frame == "r_wrist" else ("l_wrist", "r_wrist")
        ends.append([mirror * place for place in (*places, *(hands[name] for name in order))])
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-3)  # the URDFs' masses are not perfectly symmetric


def test_a_robot_without_collision_bodies_has_nothing_to_collide(g1: RobotModel, tmp_path: Path) -> None:
    tree = ET.parse(g1.urdf).getroot()
    for link in tree.findall("link"):
        for shape in link.findall("collision"):
            link.remove(shape)
    (tmp_path / "bare.urdf").write_text(ET.tostring(tree, encoding="unicode"))
    data = yaml.safe_load(Path(g1.profile.source).read_text())
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(data | {"urdf": "bare.urdf"}))
    model = RobotModel.load(tmp_path / "bare.yaml")
    assert MotionPlanner(model).plan("wave", model.posture("stand")).joint_names == g1.joint_names
