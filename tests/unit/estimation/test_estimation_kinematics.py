"""The estimator's compiled kinematics against Pinocchio's."""

import numpy as np
import pinocchio as pin
import pytest

from controllers.estimation.kinematics import SoleKinematics, base_state
from models.errors import RobotModelError
from models.robot_model import RobotModel
from models.tree import read_tree

ENCODER, POSITION, ORIENTATION = 2e-3, 1e-4, 3e-4


def kinematics_of(model: RobotModel) -> SoleKinematics:
    return SoleKinematics(model, encoder=ENCODER, position=POSITION, orientation=ORIENTATION)


def random_joints(model: RobotModel, rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(model.q_lower, model.q_upper)


def relative_poses(model: RobotModel, q: np.ndarray) -> list[pin.SE3]:
    """Pose of each sole in the IMU's frame, by Pinocchio."""
    data = model.data()
    pin.framesForwardKinematics(model.pin, data, np.concatenate([pin.neutral(model.pin)[:7], q]))
    imu = data.oMf[model.frame_id("imu")]
    return [imu.actInv(data.oMf[foot.frame_id]) for foot in model.feet]


def test_sole_poses_are_pinocchios(robot: RobotModel) -> None:
    kinematics = kinematics_of(robot)
    rng = np.random.default_rng(0)
    for _ in range(10):
        q = random_joints(robot, rng)
        kinematics.update(q)
        for foot, pose in enumerate(relative_poses(robot, q)):
            np.testing.assert_allclose(kinematics.soles.rotations[foot], pose.rotation, atol=1e-12)
            np.testing.assert_allclose(kinematics.soles.positions[foot], pose.translation, atol=1e-12)


def test_covariance_is_that_of_the_encoders(robot: RobotModel) -> None:
    """Against the numerical Jacobian of the relative pose with respect to every joint of the robot."""
    kinematics = kinematics_of(robot)
    q = random_joints(robot, np.random.default_rng(1))
    kinematics.update(q)
    covariances = kinematics.soles.covariances.copy()
    nominal = relative_poses(robot, q)
    step = 1e-6
    jacobians = np.zeros((2, 6, robot.nj))
    for joint in range(robot.nj):
        moved = q.copy()
        moved[joint] += step
        for foot, pose in enumerate(relative_poses(robot, moved)):
            jacobians[foot, :3, joint] = nominal[foot].rotation.T @ (pose.translation - nominal[foot].translation)
            jacobians[foot, 3:, joint] = pin.log3(nominal[foot].rotation.T @ pose.rotation)
    jacobians /= step
    floor = np.diag([POSITION**2] * 3 + [ORIENTATION**2] * 3)
    for foot in range(2):
        expected = ENCODER**2 * jacobians[foot] @ jacobians[foot].T + floor
        np.testing.assert_allclose(covariances[foot], expected, atol=1e-4 * np.abs(expected).max())


def test_base_state_inverts_the_mounting(robot: RobotModel) -> None:
    """From the true state of the IMU, the true base; on TALOS the waist moves between the two."""
    rng = np.random.default_rng(2)
    kinematics = kinematics_of(robot)
    q = np.concatenate([rng.normal(size=3), pin.Quaternion(pin.exp3(rng.normal(size=3))).coeffs()])
    q = np.concatenate([q if q[6] >= 0.0 else np.concatenate([q[:3], -q[3:]]), random_joints(robot, rng)])
    v = rng.normal(size=robot.nv)
    data = robot.data()
    pin.forwardKinematics(robot.pin, data, q, v)
    pose = pin.updateFramePlacement(robot.pin, data, robot.frame_id("imu"))
    twist = pin.getFrameVelocity(robot.pin, data, robot.frame_id("imu"), pin.LOCAL)
    vectors = np.stack([pose.rotation @ twist.linear, pose.translation, np.zeros(3), np.zeros(3)])
    bias = np.array([[0.1, -0.2, 0.3], [0.0, 0.0, 0.0]])
    kinematics.update(q[7:])
    q_out, v_out = np.empty(robot.nq), np.empty(robot.nv)
    base_state(
        np.ascontiguousarray(pose.rotation), vectors, bias, twist.angular + bias[0],
        np.stack([q[7:], v[6:], np.zeros(robot.nj)]), kinematics.imu, q_out, v_out,
    )  # fmt: skip
    np.testing.assert_allclose(q_out, q, atol=1e-12)
    np.testing.assert_allclose(v_out, v, atol=1e-12)


def test_talos_has_joints_between_base_and_inertial_unit(g1: RobotModel, talos: RobotModel) -> None:
    assert kinematics_of(g1).imu.columns.size == 0
    assert kinematics_of(talos).imu.columns.size == 2


def test_prismatic_joint_is_refused_by_name() -> None:
    model = pin.Model()
    base = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root_joint")
    slide = model.addJoint(base, pin.JointModelPZ(), pin.SE3.Identity(), "telescope")
    model.appendBodyToJoint(slide, pin.Inertia.Random(), pin.SE3.Identity())
    with pytest.raises(RobotModelError, match=r"telescope.*not revolute"):
        read_tree(model)
