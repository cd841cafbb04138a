"""MuJoCo against Pinocchio at random states: dynamics, kinematics and the IMU."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from models.constants import GRAVITY
from models.mujoco_model import MujocoModel
from models.robot_model import RobotModel
from tests.mujoco_states import placed, random_state

EQUAL = 1e-8
"""Largest difference allowed between the two libraries [SI]."""

SAMPLES = 20


def _velocity_map(robot: RobotModel, mj: MujocoModel, q: np.ndarray) -> np.ndarray:
    """S of qvel = S v (nv, nv)."""
    s = np.zeros((robot.nv, robot.nv))
    s[:3, :3] = pin.XYZQUATToSE3(q[:7]).rotation
    s[3:6, 3:6] = np.eye(3)
    s[mj.joint_qvel, 6 + np.arange(robot.nj)] = 1.0
    return s


def _mass_matrix(mj: MujocoModel, data: mujoco.MjData) -> np.ndarray:
    """M (nv, nv) from products with unit vectors, which every version of MuJoCo has."""
    nv = mj.model.nv
    matrix = np.empty((nv, nv))
    for i in range(nv):
        mujoco.mj_mulM(mj.model, data, matrix[i], np.eye(nv)[i])
    return matrix


@pytest.mark.parametrize("seed", range(SAMPLES))
def test_mass_matrix_with_rotors(robot: RobotModel, mj: MujocoModel, seed: int) -> None:
    q, v = random_state(robot, seed)
    s = _velocity_map(robot, mj, q)
    mass = s.T @ _mass_matrix(mj, placed(robot, mj, q, v)) @ s
    np.testing.assert_allclose(mass, pin.crba(robot.pin, robot.data(), q), atol=EQUAL, rtol=0.0)


@pytest.mark.parametrize("seed", range(SAMPLES))
def test_bias_forces(robot: RobotModel, mj: MujocoModel, seed: int) -> None:
    """At constant body twist the free joint's world acceleration is R (w x v): h_pin = S^T (M dS/dt v + h)."""
    q, v = random_state(robot, seed)
    data, s = placed(robot, mj, q, v), _velocity_map(robot, mj, q)
    s_dot_v = np.zeros(robot.nv)
    s_dot_v[:3] = s[:3, :3] @ np.cross(v[3:6], v[:3])
    bias = s.T @ (_mass_matrix(mj, data) @ s_dot_v + data.qfrc_bias)
    np.testing.assert_allclose(bias, pin.nle(robot.pin, robot.data(), q, v), atol=EQUAL, rtol=0.0)


@pytest.mark.parametrize("seed", range(SAMPLES))
def test_inverse_dynamics(robot: RobotModel, mj: MujocoModel, seed: int) -> None:
    """The acceleration that MuJoCo computes needs, in Pinocchio, the torques that were applied."""
    q, v = random_state(robot, seed)
    data = placed(robot, mj, q, v)
    if data.nefc > np.count_nonzero(robot.frictionloss):
        pytest.fail("the random state touches a limit or the floor")
    data.ctrl[mj.actuator] = 0.3 * robot.tau_max
    mujoco.mj_forward(mj.model, data)
    s = _velocity_map(robot, mj, q)
    acceleration = s.T @ data.qacc
    acceleration[:3] -= np.cross(v[3:6], v[:3])
    applied = data.qfrc_actuator + data.qfrc_passive + data.qfrc_constraint
    torque = pin.rnea(robot.pin, robot.data(), q, v, acceleration)
    np.testing.assert_allclose(torque, s.T @ applied, atol=1e-6, rtol=0.0)


@pytest.mark.parametrize("seed", range(SAMPLES))
def test_frames_and_com(robot: RobotModel, mj: MujocoModel, seed: int) -> None:
    q, v = random_state(robot, seed)
    data, expected = placed(robot, mj, q, v), robot.data()
    pin.forwardKinematics(robot.pin, expected, q, v)
    pin.updateFramePlacements(robot.pin, expected)
    for name in robot.frame_names:
        frame, site = robot.frame_id(name), mj.model.site(name).id
        placement, twist = expected.oMf[frame], pin.getFrameVelocity(robot.pin, expected, frame, pin.LOCAL)
        np.testing.assert_allclose(data.site_xpos[site], placement.translation, atol=EQUAL, err_msg=name)
        np.testing.assert_allclose(data.site_xmat[site].reshape(3, 3), placement.rotation, atol=EQUAL, err_msg=name)
        velocity = np.empty(6)
        mujoco.mj_objectVelocity(mj.model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 1)
        np.testing.assert_allclose(velocity[3:], twist.linear, atol=EQUAL, err_msg=name)
        np.testing.assert_allclose(velocity[:3], twist.angular, atol=EQUAL, err_msg=name)
    com = pin.centerOfMass(robot.pin, expected, q)
    np.testing.assert_allclose(data.subtree_com[mj.base_body], com, atol=EQUAL)


@pytest.mark.parametrize("seed", range(5))
def test_imu(robot: RobotModel, mj: MujocoModel, seed: int) -> None:
    """Gyro and accelerometer against the twist and the acceleration of the IMU frame in Pinocchio."""
    q, v = random_state(robot, seed)
    data, expected = placed(robot, mj, q, v), robot.data()
    acceleration = _velocity_map(robot, mj, q).T @ data.qacc
    acceleration[:3] -= np.cross(v[3:6], v[:3])
    pin.forwardKinematics(robot.pin, expected, q, v, acceleration)
    frame = robot.frame_id("imu")
    pin.updateFramePlacements(robot.pin, expected)
    twist = pin.getFrameVelocity(robot.pin, expected, frame, pin.LOCAL)
    classical = pin.getFrameClassicalAcceleration(robot.pin, expected, frame, pin.LOCAL)
    gravity = expected.oMf[frame].rotation.T @ np.array([0.0, 0.0, -GRAVITY])
    np.testing.assert_allclose(data.sensordata[mj.gyro], twist.angular, atol=EQUAL)
    np.testing.assert_allclose(data.sensordata[mj.accel], classical.linear - gravity, atol=1e-6)
