"""Fall and slip, as the monitor scores them."""

from dataclasses import asdict

import mujoco
import numpy as np
import pytest

from bridge.loop.lockstep import PlantMonitor
from bridge.plants.base import ReleaseGate, hanging_command
from bridge.plants.config import LoopConfig
from bridge.plants.mujoco import MujocoPlant
from controllers.joints.joint_servo import JointServo
from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel

CONFIG = default_config(LoopConfig, "bridge", "closed_loop")
DT = 0.001


def standing(model: RobotModel) -> tuple[MujocoPlant, PlantMonitor]:
    """A robot let go for an instant, its feet loaded, and its monitor."""
    plant = MujocoPlant(model, sensor_noise=False)
    servo, command = JointServo(model), hanging_command(model)
    servo.arm()
    for k in range(350):
        sensors = plant.read()
        servo.command(command, sensors.t)
        plant.write(servo.step(sensors.t, sensors.q, sensors.v, DT))
        if k == 300:
            plant.release()
        plant.step()
    monitor = PlantMonitor(plant, CONFIG)
    monitor.update()
    assert not monitor.fallen and plant.wrenches[:, 2].min() > CONFIG.slip_load * GRAVITY * model.mass
    return plant, monitor


def test_slip_is_the_slide_of_a_loaded_foot(g1: RobotModel) -> None:
    plant, monitor = standing(g1)
    assert monitor.foot_slip.max() < 1e-12
    plant.data.qpos[0] += 0.003
    plant.data.qpos[1] -= 0.004
    mujoco.mj_kinematics(plant.model, plant.data)
    monitor.update()
    np.testing.assert_allclose(monitor.foot_slip, 0.005, atol=1e-9)
    plant.data.qpos[0] -= 0.003
    plant.data.qpos[1] += 0.004
    mujoco.mj_kinematics(plant.model, plant.data)
    monitor.update()
    np.testing.assert_allclose(monitor.foot_slip, 0.005, atol=1e-9)  # the largest is kept
    monitor.reset()
    assert not monitor.foot_slip.any()


def test_turning_on_the_spot_is_slip(g1: RobotModel) -> None:
    plant, monitor = standing(g1)
    ankle = g1.joint_index("left_hip_yaw_joint")
    before = plant.data.site_xpos[plant.mujoco.sole_sites[0]].copy()
    plant.data.qpos[plant.mujoco.joint_qpos[ankle]] += 0.1
    mujoco.mj_kinematics(plant.model, plant.data)
    monitor.update()
    moved = np.linalg.norm((plant.data.site_xpos[plant.mujoco.sole_sites[0]] - before)[:2])
    assert monitor.foot_slip[0] > moved + 0.09 * np.linalg.norm(g1.feet[0].corners, axis=1).max()
    assert monitor.foot_slip[1] < 1e-12


def test_unloaded_foot_does_not_slip(g1: RobotModel) -> None:
    plant, monitor = standing(g1)
    plant.data.sensordata[plant.mujoco.sole_force[0]] = 0.0
    plant.data.qpos[0] += 0.01
    mujoco.mj_kinematics(plant.model, plant.data)
    monitor.update()
    np.testing.assert_allclose(monitor.foot_slip, [0.0, 0.01], atol=1e-9)


def test_low_base_is_a_fall(g1: RobotModel) -> None:
    plant, monitor = standing(g1)
    plant.data.qpos[2] *= 0.99 * CONFIG.fall_height
    monitor.update()
    assert monitor.fallen and "standing height" in monitor.reason
    plant.data.qpos[2] = 1.0
    monitor.update()
    assert monitor.fallen  # for good


def test_the_height_of_the_base_counts_over_the_ground_below_it(g1: RobotModel) -> None:
    plant = MujocoPlant(g1, terrain="slope_down")
    monitor = PlantMonitor(plant, CONFIG)
    plant.data.qpos[0] = 6.0
    plant.data.qpos[2] += plant.ground.height(6.0, 0.0)
    assert plant.data.qpos[2] < 0.0
    monitor.update()
    assert not monitor.fallen
    plant.data.qpos[0] = 0.0
    monitor.update()
    assert monitor.fallen


@pytest.mark.parametrize(("factor", "fallen"), [(0.97, False), (1.03, True)])
def test_tilted_base_is_a_fall(g1: RobotModel, factor: float, fallen: bool) -> None:
    plant, monitor = standing(g1)
    plant.data.qpos[2] += 1.0
    half = 0.5 * factor * CONFIG.fall_tilt
    plant.data.qpos[3:7] = [np.cos(half), 0.0, np.sin(half), 0.0]
    mujoco.mj_forward(plant.model, plant.data)
    monitor.update()
    assert monitor.fallen is fallen
    assert ("tilted" in monitor.reason) is fallen


def test_anything_but_a_sole_on_the_floor_is_a_fall(g1: RobotModel) -> None:
    """Sunk into the floor up to the thighs, with the limits on height and tilt out of the way."""
    plant, monitor = standing(g1)
    loose = LoopConfig(**{**asdict(CONFIG), "fall_height": 0.01, "fall_tilt": 3.1})
    monitor = PlantMonitor(plant, loose)
    plant.data.qpos[2] = 0.3
    mujoco.mj_forward(plant.model, plant.data)
    assert plant.data.ncon > 8
    monitor.update()
    assert monitor.fallen and "touches the floor" in monitor.reason
    body = monitor.reason.split()[0]
    assert body in plant.mujoco.bodies and "sole" not in body


def test_diverged_simulation_is_a_fall(g1: RobotModel) -> None:
    plant, monitor = standing(g1)
    plant.data.qpos[2] = np.nan
    monitor.update()
    assert monitor.fallen


def test_release_gate_opens_on_load_and_time(g1: RobotModel) -> None:
    for share, opens in ((1.0, True), (0.9, False), (1.1, False), (0.97, True)):
        gate = ReleaseGate(g1, CONFIG)
        opened = [gate.update(share * gate.weight, DT) for _ in range(1000)]
        assert any(opened) is opens
        if opens:
            assert opened.index(True) * DT >= CONFIG.settle_time - 2 * DT
            assert gate.load == pytest.approx(share * gate.weight)


def test_release_gate_accepts_more_excess_the_longer_it_waits(g1: RobotModel) -> None:
    for share, after in ((1.15, 3.0 * CONFIG.settle_time), (0.85, None)):
        gate = ReleaseGate(g1, CONFIG)
        opened = [gate.update(share * gate.weight, DT) for _ in range(round(CONFIG.settle_limit / DT))]
        assert any(opened) is (after is not None)
        if after is not None:
            assert opened.index(True) * DT == pytest.approx(after, abs=CONFIG.load_window + DT)
