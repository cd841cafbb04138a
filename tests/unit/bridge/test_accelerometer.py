"""The accelerometer integrates: at a lower rate than that of the physics, no velocity is lost."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from bridge.plants.gantry import HangingRobot
from bridge.plants.mujoco import MujocoPlant
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData, Vector

PERIOD = 0.002


def hanging() -> tuple[MujocoPlant, Callable[[JointCommand], SensorData]]:
    """A robot behind a protocol, and its next state."""
    side = HangingRobot(rate=1.0 / PERIOD, sensor_noise=False)

    def advance(command: JointCommand) -> SensorData:
        side.command = command
        for _ in range(side.ticks):
            side.step()
        return side.read()

    return side.plant, advance


def released() -> tuple[MujocoPlant, Callable[[JointCommand], SensorData]]:
    """A robot whose tick has several physics steps, and its next sample."""
    plant = MujocoPlant(RobotModel.load("g1"), timestep=PERIOD, sensor_noise=False)
    plant.release()

    def advance(command: JointCommand) -> SensorData:
        plant.write(command)
        plant.step()
        return plant.read()

    return plant, advance


def velocity(plant: MujocoPlant) -> Vector:
    """True velocity of the IMU in W (3,) [m/s]."""
    both = np.empty(6)
    kind = mujoco.mjtObj.mjOBJ_SITE
    mujoco.mj_objectVelocity(plant.model, plant.data, kind, plant.mujoco.imu_site, both, 0)
    return both[3:]


@pytest.mark.parametrize("make", [hanging, released])
def test_integrates_to_the_velocity(
    make: Callable[[], tuple[MujocoPlant, Callable[[JointCommand], SensorData]]],
) -> None:
    plant, advance = make()
    nj = plant.robot.nj
    largest = 0.2 * plant.robot.tau_max
    integral = velocity(plant)
    for tick in range(100):
        before = plant.data.site_xmat[plant.mujoco.imu_site].reshape(3, 3).copy()
        # Torques fade from step to step, so that the last step of a tick differs from the first.
        command = JointCommand(np.zeros(nj), np.zeros(nj), (-1) ** tick * largest, np.zeros(nj), plant.robot.kd)
        force = advance(command).accel
        rotation = 0.5 * (before + plant.data.site_xmat[plant.mujoco.imu_site].reshape(3, 3))
        integral += PERIOD * (rotation @ force - [0.0, 0.0, GRAVITY])
    assert np.abs(integral - velocity(plant)).max() < 0.008  # the last steps alone: 0.02 and 0.04
