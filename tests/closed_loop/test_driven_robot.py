"""The simulated robot with its drivers: what a mode does to them, and how little their torque steps."""

import numpy as np
import pytest

from bridge.driver.drivers import SimulatedDrivers
from bridge.plants.base import hanging_command
from bridge.plants.config import LoopConfig
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.sensors import SensorErrors
from controllers.joints.joint_servo import ServoState
from models.config import default_config
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import Mode


@pytest.fixture
def driven(g1: RobotModel) -> SimulatedDrivers:
    return SimulatedDrivers(MujocoPlant(g1), g1, default_config(LoopConfig, "bridge", "closed_loop"))


def test_active_drivers_are_switched_off_through_damp_only(driven: SimulatedDrivers) -> None:
    driven.set_mode(Mode.STAND)
    driven.plant.release()
    with pytest.raises(CommandError, match="request 'damp' first"):
        driven.set_mode(Mode.OFF)
    assert driven.servo.state is ServoState.ACTIVE
    assert driven.awaits_command  # still in mode stand
    driven.set_mode(Mode.DAMP)
    driven.set_mode(Mode.OFF)
    assert driven.servo.state is ServoState.OFF


def test_encoder_offsets_are_corrected_for_drivers_and_readers_alike(g1: RobotModel) -> None:
    """A robot whose encoders are off by what the drivers subtract behaves as one whose encoders are right."""
    config = default_config(LoopConfig, "bridge", "closed_loop")
    plain = SimulatedDrivers(MujocoPlant(g1, sensor_noise=False), g1, config)
    offsets = np.random.default_rng(0).uniform(-0.03, 0.03, g1.nj)
    off = SimulatedDrivers(
        MujocoPlant(g1, sensor_noise=False, sensor_errors=SensorErrors(encoder_offsets=offsets)), g1, config
    )
    off.encoder_offsets = offsets
    off.reset()
    settled = [robot.settle() for robot in (plain, off)]
    np.testing.assert_allclose(off.plant.truth.q, plain.plant.truth.q, atol=1e-9)
    np.testing.assert_allclose(settled[1].q, settled[0].q, atol=1e-9)
    np.testing.assert_allclose(off.plant.read().q - off.read().q, offsets, atol=1e-12)
    off.encoder_offsets = None
    off.reset()
    off.settle()
    assert np.abs(off.plant.truth.q - plain.plant.truth.q).max() > 0.01  # [rad]


def test_a_hanging_robot_takes_no_mode_to_move_in_until_it_is_let_down(driven: SimulatedDrivers) -> None:
    assert driven.movable and driven.state == "held"
    driven.reset(hanging=True)
    driven.settle()
    assert driven.movable and driven.state == "hanging"
    assert np.abs(driven.plant.wrenches[:, 2]).max() < 1.0
    with pytest.raises(CommandError, match="'stand' refused: the robot hangs"):
        driven.set_mode(Mode.STAND)
    assert not driven.awaits_command
    driven.reset()
    assert driven.state == "held"
    driven.set_mode(Mode.STAND)
    assert driven.awaits_command and not driven.movable
    driven.plant.release()
    driven.set_mode(Mode.DAMP)
    assert not driven.movable
    driven.set_mode(Mode.OFF)
    assert driven.movable


def test_commands_that_cease_while_the_robot_is_held_leave_its_drivers_ready(driven: SimulatedDrivers) -> None:
    """Nothing would arm them again: to the supervisor a held robot is as well as it was."""
    driven.settle()
    driven.set_mode(Mode.STAND)
    carrying = hanging_command(driven.plant.robot)
    assert driven.command(carrying)
    before = driven.plant.truth.q.copy()
    silence = 3.0 * driven.servo.config.command_timeout
    for _ in range(round(silence / driven.plant.period)):
        driven.step()
    assert (driven.interruptions, driven.servo.timeouts) == (1, 0)
    assert driven.state == "held" and driven.awaits_command
    assert driven.command(carrying)
    np.testing.assert_allclose(driven.plant.truth.q, before, atol=5e-3)  # drivers that damp sag by 0.02 rad
