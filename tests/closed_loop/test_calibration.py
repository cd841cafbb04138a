"""Calibration in the loop: injected errors are found, and the robot then stands as well as one without them."""

from dataclasses import dataclass

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from bridge.plants.sensors import SensorErrors
from controllers.calibration.closed_chain import ChainTerms
from models.calibration import Calibration
from models.robot_model import RobotModel
from models.types import Mode, Vector

SEED = 4
SHARE = 0.05
"""What may be left of an injected error."""

GYRO, ENCODER, FORCE = 0.05, 0.03, 15.0


def signs(seed: int, *shape: int) -> Vector:
    return np.random.default_rng(seed).choice([-1.0, 1.0], shape)


@dataclass(frozen=True)
class Standing:
    """How well a robot stood for two seconds."""

    speed: float
    drift: float
    tilt: float


def stand(loop: ClosedLoop) -> Standing:
    start, speeds = loop.plant.com, []
    for _ in range(100):
        loop.run(0.02)
        speeds.append(np.abs(loop.truth.v[6:]).mean())
    assert loop.mode is Mode.STAND and not loop.fallen
    return Standing(
        speed=float(np.mean(speeds)),
        drift=float(np.linalg.norm((loop.plant.com - start)[:2])),
        tilt=float(2.0 * np.linalg.norm(loop.truth.q[3:5])),
    )


def as_good(loop: ClosedLoop, errors: SensorErrors, calibration: Calibration | None) -> None:
    """Standing in a loop with errors and their calibration, against the same loop without either."""
    clean = stand(ClosedLoop(loop.robot, seed=SEED, record=False))
    calibrated = stand(ClosedLoop(loop.robot, seed=SEED, sensor_errors=errors, calibration=calibration, record=False))
    assert calibrated.speed < 1.2 * clean.speed + 5e-4, (calibrated, clean)
    assert calibrated.drift < clean.drift + 1e-3, (calibrated, clean)
    assert calibrated.tilt < clean.tilt + 2e-3, (calibrated, clean)


@pytest.mark.long
def test_hanging_calibration_recovers_gyro_force_and_all_encoders(robot: RobotModel) -> None:
    errors = SensorErrors(
        gyro_bias=GYRO * signs(0, 3), encoder_offsets=ENCODER * signs(1, robot.nj), force_offsets=FORCE * signs(2, 2, 3)
    )
    loop = ClosedLoop(robot, seed=SEED, sensor_errors=errors, start="hang", record=False)
    assert loop.mode is Mode.OFF
    for what in ("imu", "feet", "joints"):
        reply = loop.calibrate(what)
        assert reply.accepted, reply.reason
    found, nj, bias = loop.calibration, robot.nj, loop.plant.noise.bias
    assert found is not None
    assert np.abs(found.gyro_bias - bias[3 * nj : 3 * nj + 3]).max() < SHARE * GYRO
    assert np.abs(found.encoder_offsets - bias[:nj]).max() < SHARE * ENCODER
    assert np.abs(found.wrench_offsets.ravel() - bias[-12:])[[0, 1, 2, 6, 7, 8]].max() < SHARE * FORCE
    as_good(loop, errors, found)


def closed_chain(robot: RobotModel) -> None:
    joints = ChainTerms(robot).joints
    offsets = np.zeros(robot.nj)
    offsets[joints] = ENCODER * signs(1, joints.size)
    errors = SensorErrors(encoder_offsets=offsets)
    loop = ClosedLoop(robot, seed=SEED, sensor_errors=errors, record=False)
    worst = []
    for _ in range(2):  # the second pass stands on legs that no longer work against each other
        reply = loop.calibrate("joints")
        assert reply.accepted, reply.reason
        assert loop.calibration is not None
        worst.append(np.abs(loop.calibration.encoder_offsets - loop.plant.noise.bias[: robot.nj])[joints].max())
        loop.reset()
    print(robot.name, "worst offset after each pass [rad]", worst)
    assert worst[0] < 0.1 * ENCODER and worst[1] < SHARE * ENCODER, worst
    assert not np.delete(loop.calibration.encoder_offsets, joints).any()
    as_good(loop, errors, loop.calibration)


@pytest.mark.slow
def test_closed_chain_recovers_the_legs_of_the_g1(g1: RobotModel) -> None:
    closed_chain(g1)


@pytest.mark.slow
def test_closed_chain_recovers_the_legs_and_waist_of_talos(talos: RobotModel) -> None:
    closed_chain(talos)


@pytest.mark.long
def test_standing_calibration_of_imu_and_gains(g1: RobotModel) -> None:
    errors = SensorErrors(gyro_bias=GYRO * signs(5, 3), wrench_gains=0.06 * signs(6, 2, 1))
    loop = ClosedLoop(g1, seed=SEED, sensor_errors=errors, record=False)
    loop.run(1.5)  # until the state estimator has found most of the bias itself, the robot rocks
    assert loop.calibrate("imu").accepted
    assert loop.calibration is not None
    at = 3 * g1.nj
    assert np.abs(loop.calibration.gyro_bias - loop.plant.noise.bias[at : at + 3]).max() < SHARE * GYRO
    reply = loop.calibrate("feet")
    assert reply.accepted, reply.reason
    true = 1.0 / loop.plant.noise.gains[[8, 14], [8, 14]]
    np.testing.assert_allclose(loop.calibration.force_gains, true, atol=SHARE * 0.1 + 0.01)
    assert "of each foot" in reply.reason
    running = loop.calibration
    assert loop.command("squat").accepted
    loop.run(0.5)
    refused = loop.calibrate("imu")
    assert not refused.accepted and "mode 'motion'" in refused.reason
    assert not loop.calibrate("nose").accepted
    assert loop.calibration is running


def test_a_swinging_robot_is_refused_and_two_runs_agree(g1: RobotModel) -> None:
    loop = ClosedLoop(g1, seed=SEED, start="hang", record=False)
    # the weights of a robot that hangs are held by the crane: a push swings its arms and legs
    loop.apply_push((300.0, 0.0, 0.0), duration=4.0, body="l_sole")
    reply = loop.calibrate("imu")
    assert not reply.accepted and "moves" in reply.reason and reply.details["joint_drift"] > 0.02
    assert loop.calibration is None
    replies = [ClosedLoop(g1, seed=SEED, start="hang", record=False).calibrate("imu") for _ in range(2)]
    assert replies[0] == replies[1] and replies[0].accepted
