"""A bearing foot that slides under a robot whose base stands still."""

import numpy as np
import pinocchio as pin
import pytest

from controllers.estimation.estimator import StateEstimator
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import SensorData

DT, SLIDE_AT, SLIDE_TIME, SLIDE = 0.001, 0.3, 0.06, 0.03


def sliding(robot: RobotModel, distance: float) -> list[SensorData]:
    """Exact sensors of a robot whose left sole moves forward by a distance [m] while both feet bear."""
    data, start = robot.data(), robot.standing_configuration()
    pin.framesForwardKinematics(robot.pin, data, start)
    foot = robot.feet[0]
    home = data.oMf[foot.frame_id].copy()
    force = np.zeros((2, 6))
    force[:, 2] = 0.5 * robot.mass * GRAVITY
    imu = data.oMf[robot.frame_id("imu")].rotation
    samples, q, before = [], start.copy(), start[7:].copy()
    for k in range(800):
        t = k * DT
        phase = np.clip((t - SLIDE_AT) / SLIDE_TIME, 0.0, 1.0)
        target = home.copy()
        target.translation = home.translation + np.array([distance * 0.5 * (1.0 - np.cos(np.pi * phase)), 0.0, 0.0])
        for _ in range(3 if 0.0 < phase < 1.0 else 1):
            pin.computeJointJacobians(robot.pin, data, q)
            pin.updateFramePlacements(robot.pin, data)
            error = pin.log6(data.oMf[foot.frame_id].actInv(target)).vector
            jacobian = pin.getFrameJacobian(robot.pin, data, foot.frame_id, pin.LOCAL)[:, foot.joint_ids_v]
            q[np.asarray(foot.joint_ids_v) + 1] += np.linalg.solve(jacobian, error)
        joints = q[7:].copy()
        gravity = imu.T @ np.array([0.0, 0.0, GRAVITY])
        samples.append(
            SensorData(t, joints, (joints - before) / DT, np.zeros(robot.nj), np.zeros(3), gravity, force.copy())
        )
        before = joints
    return samples


@pytest.mark.parametrize("distance", [0.0, SLIDE])
def test_a_sliding_foot_is_counted_and_does_not_carry_the_base_along(robot: RobotModel, distance: float) -> None:
    estimator = StateEstimator(robot)
    samples = sliding(robot, distance)
    state = estimator.reset(samples[0])
    start, fastest = state.q[:3].copy(), 0.0
    for sample in samples[1:]:
        state = estimator.step(sample, DT)
        fastest = max(fastest, float(np.abs(state.v[:3]).max()))
    slips = estimator.health.slips
    if not distance:
        assert slips == (0, 0)
        return
    assert slips == (1, 0)
    assert not estimator._slip.slipping.any()  # it has recovered
    assert np.abs(state.q[:3] - start).max() < 0.1 * distance
    assert fastest < 0.05  # the sole moves at 0.8 m/s
