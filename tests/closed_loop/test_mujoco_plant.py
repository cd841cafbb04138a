"""The simulated robot behind the plant's interface."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from bridge.plants.base import hanging_command
from bridge.plants.mujoco import MujocoPlant
from controllers.joints.joint_servo import JointServo
from models.constants import GRAVITY
from models.errors import CommandError, ConfigError
from models.mujoco_model import pin_to_mujoco
from models.robot_model import RobotModel
from models.types import JointCommand

DT = 0.001


def hang(plant: MujocoPlant, seconds: float) -> None:
    """Run with the drivers holding the standing posture under gravity compensation."""
    servo, command = JointServo(plant.robot), hanging_command(plant.robot)
    servo.arm()
    for _ in range(round(seconds / DT)):
        sensors = plant.read()
        servo.command(command, sensors.t)
        plant.write(servo.step(sensors.t, sensors.q, sensors.v, DT))
        plant.step()


def test_starts_held_with_the_soles_on_the_floor(robot: RobotModel) -> None:
    plant = MujocoPlant(robot, sensor_noise=False)
    np.testing.assert_allclose(plant.truth.q, robot.standing_configuration(), atol=1e-12)
    np.testing.assert_allclose(plant.data.site_xpos[list(plant.mujoco.sole_sites), 2], 0.0, atol=1e-9)
    assert plant.held
    hang(plant, 0.5)
    assert np.abs(plant.truth.q[:3] - robot.standing_configuration()[:3]).max() < 1e-3
    assert np.abs(plant.truth.q[7:] - robot.posture("stand")).max() < 0.02


def test_let_go_without_torque_it_falls(g1: RobotModel) -> None:
    plant = MujocoPlant(g1)
    height = plant.truth.q[2]
    plant.release()
    for _ in range(1000):
        plant.write(JointCommand.torque(np.zeros(g1.nj)))
        plant.step()
    assert plant.truth.q[2] < 0.6 * height
    plant.reset()
    assert plant.truth.q[2] == height and plant.t == 0.0 and plant.held


def test_hold_anywhere(g1: RobotModel) -> None:
    plant = MujocoPlant(g1)
    plant.release()
    for _ in range(150):
        plant.step()
    plant.hold()
    before = plant.truth.q[:7]
    for _ in range(100):
        plant.step()
    np.testing.assert_allclose(plant.truth.q[:7], before, atol=0.02)


def test_exact_sensors_are_the_truth(robot: RobotModel) -> None:
    """Joint state, gyro and specific force against Pinocchio, in the middle of a fall."""
    plant = MujocoPlant(robot, sensor_noise=False)
    data, imu = robot.data(), robot.frame_id("imu")
    rng = np.random.default_rng(2)
    plant.release()
    plant.data.qpos[2] += 0.5  # in the air
    mujoco.mj_forward(plant.model, plant.data)
    for _ in range(50):
        plant.write(JointCommand.torque(0.2 * robot.tau_max * rng.uniform(-1.0, 1.0, robot.nj)))
        before = plant.truth
        plant.step()
    truth, sample = plant.truth, plant.read()
    np.testing.assert_array_equal(sample.q, truth.q[7:])
    np.testing.assert_array_equal(sample.v, truth.v[6:])
    np.testing.assert_array_equal(sample.tau, truth.tau)
    assert sample.t == truth.t == pytest.approx(0.05)
    pin.forwardKinematics(robot.pin, data, truth.q, truth.v)
    velocity = pin.getFrameVelocity(robot.pin, data, imu, pin.LOCAL)
    np.testing.assert_allclose(sample.gyro, velocity.angular, atol=1e-9)
    # The accelerometer reads what acted during the last step.
    vdot = (truth.v - before.v) / DT
    pin.forwardKinematics(robot.pin, data, before.q, before.v, vdot)
    pin.updateFramePlacements(robot.pin, data)
    classical = pin.getFrameClassicalAcceleration(robot.pin, data, imu, pin.LOCAL).linear
    up = data.oMf[imu].rotation.T @ np.array([0.0, 0.0, GRAVITY])
    np.testing.assert_allclose(sample.accel, classical + up, atol=0.02 * np.linalg.norm(classical + up))


def contact_wrenches(plant: MujocoPlant) -> NDArray[np.float64]:
    """Ground reaction on each foot in its sole frame (2, 6), summed over MuJoCo's contacts one by one."""
    model, data = plant.model, plant.data
    result, force = np.zeros((2, 6)), np.zeros(6)
    for i in range(data.ncon):
        contact = data.contact[i]
        bodies = [int(model.geom_bodyid[g]) for g in contact.geom]
        mujoco.mj_contactForce(model, data, i, force)
        world = contact.frame.reshape(3, 3).T @ force[:3]  # on geom 2
        couple = contact.frame.reshape(3, 3).T @ force[3:]
        for k, site in enumerate(plant.mujoco.sole_sites):
            if int(model.site_bodyid[site]) in bodies:
                sign = 1.0 if bodies[1] == int(model.site_bodyid[site]) else -1.0
                rotation = data.site_xmat[site].reshape(3, 3)
                arm = contact.pos - data.site_xpos[site]
                result[k, :3] += sign * rotation.T @ world
                result[k, 3:] += sign * rotation.T @ (couple + np.cross(arm, world))
    return result


def test_true_wrenches_are_the_sum_of_the_contacts(robot: RobotModel) -> None:
    plant = MujocoPlant(robot, sensor_noise=False)
    hang(plant, 0.3)
    plant.release()
    hang(plant, 0.05)
    mujoco.mj_forward(plant.model, plant.data)
    expected = contact_wrenches(plant)
    assert expected[:, 2].min() > 0.1 * robot.mass * GRAVITY
    np.testing.assert_allclose(plant.wrenches, expected, atol=1e-6 * robot.mass)
    np.testing.assert_allclose([c.wrench for c in plant.truth.contacts], expected, atol=1e-6 * robot.mass)
    assert all(c.active for c in plant.truth.contacts)


def test_push_changes_momentum_by_its_impulse(robot: RobotModel) -> None:
    """In the air, 30 N for 0.1 s on top of gravity; the push begins with the next step and then ends."""
    plant = MujocoPlant(robot)
    plant.release()
    plant.data.qpos[2] += 2.0
    mujoco.mj_forward(plant.model, plant.data)
    force = np.array([20.0, -10.0, 20.0])
    plant.push(force, 0.1, "torso")
    momenta = []
    for _ in range(200):
        plant.step()
        mujoco.mj_subtreeVel(plant.model, plant.data)
        momenta.append(robot.mass * plant.data.subtree_linvel[plant.mujoco.base_body])
    weight = np.array([0.0, 0.0, -GRAVITY * robot.mass])
    np.testing.assert_allclose(momenta[0], (force + weight) * DT, atol=1e-3)
    np.testing.assert_allclose(momenta[99], force * 0.1 + weight * 0.1, atol=0.02)
    np.testing.assert_allclose(momenta[199], force * 0.1 + weight * 0.2, atol=0.04)


def test_pushes_add_up(g1: RobotModel) -> None:
    plant = MujocoPlant(g1)
    plant.push((10.0, 0.0, 0.0), 0.003)
    plant.push((0.0, 5.0, 0.0), 0.001)
    seen = []
    for _ in range(4):
        plant.step()
        seen.append(plant.data.xfrc_applied[plant.mujoco.base_body, :3].copy())
    np.testing.assert_array_equal(seen, [[10, 5, 0], [10, 0, 0], [10, 0, 0], [0, 0, 0]])


@pytest.mark.parametrize(
    ("force", "duration", "body", "culprit"),
    [
        ((1.0, 0.0, 0.0), 0.1, "tail", "unknown body 'tail'; known: .*base_link"),
        ((np.nan, 0.0, 0.0), 0.1, "base_link", "force"),
        ((1.0, 0.0), 0.1, "base_link", "force"),
        ((1.0, 0.0, 0.0), 0.0, "base_link", "duration"),
        ((1.0, 0.0, 0.0), np.inf, "base_link", "duration"),
    ],
)
def test_bad_push_is_refused(
    g1: RobotModel, force: tuple[float, ...], duration: float, body: str, culprit: str
) -> None:
    plant = MujocoPlant(g1)
    with pytest.raises(CommandError, match=culprit):
        plant.push(force, duration, body)  # type: ignore[arg-type]
    plant.step()
    assert not plant.data.xfrc_applied.any()


def test_reading_twice_gives_the_same_and_changes_nothing(g1: RobotModel) -> None:
    one, other = (MujocoPlant(g1, seed=3) for _ in range(2))
    for _ in range(20):
        first = one.read()
        assert one.read() is first
        one.step()
        other.step()
    a, b = one.read(), other.read()
    for field in ("q", "v", "tau", "gyro", "accel", "wrenches"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))


def test_samples_are_not_overwritten_later(g1: RobotModel) -> None:
    plant = MujocoPlant(g1)
    sample = plant.read()
    before = sample.v.copy()
    for _ in range(5):
        plant.step()
        plant.read()
    np.testing.assert_array_equal(sample.v, before)


def test_payload_and_friction_reach_the_world(g1: RobotModel) -> None:
    plain, loaded = MujocoPlant(g1), MujocoPlant(g1, payload_kg=3.0)
    assert loaded.model.body_mass.sum() - plain.model.body_mass.sum() == pytest.approx(3.0)
    with pytest.raises(ConfigError, match="payload_kg"):
        MujocoPlant(g1, payload_kg=-1.0)
    with pytest.raises(ConfigError, match="friction"):
        MujocoPlant(g1, friction=0.0)
    with pytest.raises(ConfigError, match="terrain"):
        MujocoPlant(g1, terrain="lava")


def test_joint_order_of_the_plant_is_that_of_the_model(robot: RobotModel) -> None:
    plant = MujocoPlant(robot, sensor_noise=False)
    q = robot.standing_configuration()
    q[7:] = np.linspace(0.1, 0.2, robot.nj)
    plant.data.qpos[:], _ = pin_to_mujoco(robot, plant.mujoco, q, np.zeros(robot.nv))
    np.testing.assert_array_equal(plant.read().q, q[7:])
    for i, name in enumerate(robot.joint_names):
        tau = np.zeros(robot.nj)
        tau[i] = 0.01
        plant.write(JointCommand.torque(tau))
        assert plant.data.actuator(name).ctrl[0] == 0.01
        assert np.count_nonzero(plant.data.ctrl) == 1
