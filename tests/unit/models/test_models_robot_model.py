"""The robot model: order, names, postures, feet and left-right symmetry."""

import numpy as np
import pinocchio as pin
import pytest

from models.errors import ConfigError, JointNameError
from models.robot_model import RobotModel

LIMIT_MARGIN = 0.05
"""Least distance of a joint of 'stand' to its limits [rad]."""


def _partner(name: str) -> str:
    """Name of the joint on the other side; its own name for a joint of the middle."""
    swapped = name.replace("left", "#").replace("right", "left")
    return swapped.replace("#", "right")


def _mirror(model: RobotModel) -> tuple[np.ndarray, np.ndarray]:
    """Partner index (nj,) and sign (nj,) of each joint under reflection at the x-z plane, from the joint axes."""
    data = model.data()
    pin.computeJointJacobians(model.pin, data, pin.neutral(model.pin))
    axes = np.array(
        [pin.getJointJacobian(model.pin, data, i + 2, pin.WORLD)[3:, 6 + i] for i in range(model.nj)]
    )  # (nj, 3)
    index = np.array([model.joint_index(_partner(name)) for name in model.joint_names])
    reflected = axes[index] * np.array([-1.0, 1.0, -1.0])  # an axial vector under y -> -y
    sign = np.round(np.sum(axes * reflected, axis=1))
    np.testing.assert_array_equal(np.abs(sign), 1.0)
    return index, sign


@pytest.mark.parametrize(("name", "nq", "nv", "mass"), [("g1", 36, 35, 33.341), ("talos", 39, 38, 90.272)])
def test_sizes(name: str, nq: int, nv: int, mass: float) -> None:
    model = RobotModel.load(name)
    assert (model.nq, model.nv, model.nj) == (nq, nv, nv - 6)
    assert model.mass == pytest.approx(mass, abs=1e-3)
    assert tuple(model.pin.names)[2:] == model.joint_names
    for i, joint in enumerate(model.joint_names):
        assert model.joint_index(joint) == i == model.pin.joints[model.pin.getJointId(joint)].idx_v - 6


def test_joint_vectors_are_complete_and_read_only(robot: RobotModel) -> None:
    drives = ["v_max", "tau_max", "tau_rate_max", "armature", "damping", "frictionloss", "kp", "kd"]
    for name in ["q_lower", "q_upper", *drives]:
        vector = getattr(robot, name)
        assert vector.shape == (robot.nj,) and np.isfinite(vector).all(), name
        with pytest.raises(ValueError, match="read-only"):
            vector[0] = 0.0
    for name in drives:
        assert (getattr(robot, name) > 0.0).all(), name


def test_armature_is_in_the_mass_matrix(robot: RobotModel) -> None:
    q = robot.standing_configuration()
    with_rotors = pin.crba(robot.pin, robot.data(), q).copy()
    bare = robot.pin.copy()
    bare.armature = np.zeros(robot.nv)
    difference = np.diag(with_rotors - pin.crba(bare, bare.createData(), q))
    np.testing.assert_allclose(difference, np.concatenate([np.zeros(6), robot.armature]), atol=1e-12)


@pytest.mark.parametrize("joint", ["left_hip_pitch_joint", "left_knee_joint", "left_ankle_roll_joint"])
def test_rotor_inertia_goes_to_the_named_joint(g1: RobotModel, joint: str) -> None:
    expected = {"left_hip_pitch_joint": 0.01017752, "left_knee_joint": 0.025101925, "left_ankle_roll_joint": 0.00721945}
    assert g1.armature[g1.joint_index(joint)] == expected[joint]


def test_reorder_undoes_a_shuffle(robot: RobotModel) -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(size=robot.nj)
    order = rng.permutation(robot.nj)
    shuffled = [robot.joint_names[i] for i in order]
    result = robot.reorder(shuffled, values[order])
    np.testing.assert_array_equal(result, values)
    result[0] = 99.0
    assert values[0] != 99.0


def test_reorder_names_the_culprit(robot: RobotModel) -> None:
    names, values = list(robot.joint_names), np.zeros(robot.nj)
    with pytest.raises(JointNameError, match=f"'{names[4]}' is missing"):
        robot.reorder(names[:4] + names[5:], values[1:])
    with pytest.raises(JointNameError, match="unknown joint 'tail'"):
        robot.reorder([*names[:-1], "tail"], values)
    with pytest.raises(JointNameError, match=f"'{names[0]}' is given twice"):
        robot.reorder([names[0], *names], np.zeros(robot.nj + 1))
    with pytest.raises(JointNameError, match="values of shape"):
        robot.reorder(names, values[1:])
    with pytest.raises(JointNameError, match="unknown joint 'tail'"):
        robot.joint_index("tail")


def test_textbook_names_are_aliases(robot: RobotModel) -> None:
    for name in robot.joint_names:
        assert robot.named([name.removesuffix("_joint")]) == (name,)
    for side in ("left", "right"):
        for joint in ("hip", "hip_pitch", "knee", "ankle", "shoulder_roll", "elbow", "wrist"):
            (name,) = robot.named([f"{side}_{joint}"])
            assert robot.named([f"{side}_{joint}_joint", f"{side[0]}_{joint}", f"{joint}_{side}"]) == (name,) * 3
    with pytest.raises(JointNameError, match="given twice"):
        robot.reorder([robot.joint_names[0], *robot.named(["left_knee"]), "left_knee"], np.zeros(3))


def test_an_unknown_joint_is_refused_with_the_nearest_one(g1: RobotModel) -> None:
    expected = (
        "unknown joint 'right_sholder_roll': did you mean 'right_shoulder_roll_joint'[?] `poise joints` lists all"
    )
    with pytest.raises(JointNameError, match=expected):
        g1.joint_index("right_sholder_roll")
    for ambiguous in ("hip_pitch", "left_hand"):
        with pytest.raises(JointNameError, match="unknown joint"):
            g1.joint_index(ambiguous)


def test_unknown_frame_and_posture_list_the_known_ones(robot: RobotModel) -> None:
    with pytest.raises(ConfigError, match=r"'tail'.*base_link, l_sole, r_sole"):
        robot.frame_id("tail")
    with pytest.raises(ConfigError, match=r"'flying'.*stand, zero"):
        robot.posture("flying")


def test_stand_keeps_away_from_the_limits(robot: RobotModel) -> None:
    q = robot.posture("stand")
    assert (q - robot.q_lower).min() > LIMIT_MARGIN
    assert (robot.q_upper - q).min() > LIMIT_MARGIN


def test_zero_posture_is_zero(robot: RobotModel) -> None:
    np.testing.assert_array_equal(robot.posture("zero"), np.zeros(robot.nj))


def test_standing_on_flat_soles_with_the_com_in_the_middle(robot: RobotModel) -> None:
    q, data = robot.standing_configuration(), robot.data()
    pin.framesForwardKinematics(robot.pin, data, q)
    corners = np.vstack([[data.oMf[foot.frame_id].act(corner) for corner in foot.corners] for foot in robot.feet])
    np.testing.assert_allclose(corners[:, 2], 0.0, atol=1e-9)
    middle = 0.5 * sum(data.oMf[foot.frame_id].translation for foot in robot.feet)
    np.testing.assert_allclose(middle, 0.0, atol=1e-12)
    for foot in robot.feet:
        np.testing.assert_allclose(data.oMf[foot.frame_id].rotation, np.eye(3), atol=1e-9)
    com = pin.centerOfMass(robot.pin, data, q)
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    assert np.linalg.norm(com[:2] - centre[:2]) < 0.005
    rotation = pin.XYZQUATToSE3(q[:7]).rotation
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-9)


def test_standing_centres_a_crooked_posture(robot: RobotModel) -> None:
    """Feet turned outward: the mid-point is still at the origin, with yaw 0."""
    posture = np.array(robot.posture("stand"))
    for foot, sign in zip(robot.feet, (1.0, -1.0), strict=True):
        for i in foot.joint_ids_v:
            axis = robot.pin.joints[robot.pin.getJointId(robot.joint_names[i - 6])].shortname()
            if axis == "JointModelRZ":
                posture[i - 6] += 0.3 * sign
    robot._postures["crooked"] = posture
    try:
        q, data = robot.standing_configuration("crooked"), robot.data()
    finally:
        del robot._postures["crooked"]
    pin.framesForwardKinematics(robot.pin, data, q)
    left, right = (data.oMf[foot.frame_id] for foot in robot.feet)
    np.testing.assert_allclose(left.translation + right.translation, 0.0, atol=1e-12)
    np.testing.assert_allclose(pin.log3(left.rotation) + pin.log3(right.rotation), 0.0, atol=1e-9)
    assert pin.log3(left.rotation)[2] > 0.25  # outward; the thigh's tilt takes some of the 0.3 rad


def test_feet(robot: RobotModel) -> None:
    assert [foot.name for foot in robot.feet] == ["left", "right"]
    for foot, frame in zip(robot.feet, ("l_sole", "r_sole"), strict=True):
        assert robot.frame_id(frame) == foot.frame_id
        assert robot.pin.frames[foot.frame_id].name == frame
        names = [robot.joint_names[i - 6] for i in foot.joint_ids_v]
        assert len(names) == 6 and all(foot.name in name for name in names)
        x_min, x_max, y_min, y_max = foot.rectangle
        assert {tuple(corner) for corner in foot.corners[:, :2]} == {
            (x, y) for x in (x_min, x_max) for y in (y_min, y_max)
        }
        # The leg's columns are all that moves the sole.
        jacobian = pin.computeFrameJacobian(
            robot.pin, robot.data(), robot.standing_configuration(), foot.frame_id, pin.LOCAL
        )
        moving = {i for i in range(6, robot.nv) if np.abs(jacobian[:, i]).max() > 0.0}
        assert moving == set(foot.joint_ids_v)


def test_frames_point_forward_left_up_when_standing(robot: RobotModel) -> None:
    q, data = robot.standing_configuration(), robot.data()
    pin.framesForwardKinematics(robot.pin, data, q)
    for name in ("base_link", "torso", "imu", "l_sole", "r_sole"):
        np.testing.assert_allclose(data.oMf[robot.frame_id(name)].rotation, np.eye(3), atol=1e-9, err_msg=name)
    assert data.oMf[robot.frame_id("gaze")].rotation[0, 0] > 0.5  # looks ahead
    left, right = (data.oMf[robot.frame_id(name)].translation for name in ("l_wrist", "r_wrist"))
    np.testing.assert_allclose(left * [1.0, -1.0, 1.0], right, atol=1e-4)
    assert left[1] > 0.1


def test_profile_is_mirror_symmetric(robot: RobotModel) -> None:
    index, sign = _mirror(robot)
    for name in ["v_max", "tau_max", "tau_rate_max", "armature", "damping", "frictionloss", "kp", "kd"]:
        vector = getattr(robot, name)
        np.testing.assert_array_equal(vector, vector[index], err_msg=name)
    lower = np.where(sign > 0.0, robot.q_lower[index], -robot.q_upper[index])
    np.testing.assert_allclose(robot.q_lower, lower, atol=1e-9)
    for posture in robot.posture_names:
        np.testing.assert_array_equal(robot.posture(posture), sign * robot.posture(posture)[index], err_msg=posture)
    left, right = robot.feet
    assert left.rectangle == (right.rectangle[0], right.rectangle[1], -right.rectangle[3], -right.rectangle[2])
