"""Calibration of the legs from the closed chain, on made-up postures: Jacobians, exactness, observability."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from controllers.calibration.closed_chain import ChainTerms, calibrate_closed_chain
from controllers.calibration.config import CalibrationConfig
from controllers.calibration.windows import Window
from models.calibration import Calibration
from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Vector

CONFIG = default_config(CalibrationConfig, "controllers", "calibration")
UP = np.array([0.0, 0.0, GRAVITY])


def legs(model: RobotModel, base_rpy: tuple[float, float, float], lower: float, seed: Vector) -> Vector:
    """Configuration (nq,) with the base turned and lowered over both soles, by Newton on each leg."""
    data, q = model.data(), seed.copy()
    stand = model.standing_configuration()
    pin.framesForwardKinematics(model.pin, data, stand)
    goals = [data.oMf[foot.frame_id].copy() for foot in model.feet]
    q[:3] = stand[:3] - [0.0, 0.0, lower * stand[2]]
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(*base_rpy)).coeffs()
    for _ in range(30):
        pin.computeJointJacobians(model.pin, data, q)
        pin.framesForwardKinematics(model.pin, data, q)
        for foot, goal in zip(model.feet, goals, strict=True):
            error = pin.log6(data.oMf[foot.frame_id].actInv(goal)).vector
            columns = list(foot.joint_ids_v)
            jacobian = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.LOCAL)[:, columns]
            q[[i + 1 for i in columns]] += np.clip(np.linalg.solve(jacobian, error), -0.2, 0.2)
    pin.framesForwardKinematics(model.pin, data, q)
    for foot, goal in zip(model.feet, goals, strict=True):
        assert np.abs(pin.log6(data.oMf[foot.frame_id].actInv(goal)).vector).max() < 1e-9
    return q


def tour(model: RobotModel, steps: int = 15) -> list[Vector]:
    """Configurations on a tour over the workspace of the base; each key pose is a rest."""
    yaw, roll = (0.3, 0.12) if model.name == "g1" else (0.15, 0.1)
    waist = [
        i for i in ChainTerms(model).joints if 6 + i not in {*model.feet[0].joint_ids_v, *model.feet[1].joint_ids_v}
    ]
    keys = [
        (roll, 0.0, yaw, 0.04), (0.0, 0.3, 0.0, 0.08), (roll, 0.0, -yaw, 0.12), (0.0, -0.3, 0.0, 0.06),
        (-roll, 0.0, yaw, 0.12), (0.0, 0.0, -yaw, 0.12), (-roll, 0.0, -yaw, 0.04), (0.0, 0.3, yaw, 0.06),
    ]  # fmt: skip
    path, last = [], np.array([0.0, 0.0, 0.0, 0.02])
    q = model.standing_configuration()
    for n, key in enumerate(keys):
        start_waist = q[[7 + i for i in waist]]
        goal_waist = 0.5 * np.array([(-1.0) ** n, (-1.0) ** (n // 2)])[: len(waist)] * [1.0, 0.4][: len(waist)]
        for k in range(1, steps + 1):
            s = 0.5 - 0.5 * np.cos(np.pi * k / steps)
            roll_, pitch, yaw_, lower = (1.0 - s) * last + s * np.array(key)
            q = q.copy()
            q[[7 + i for i in waist]] = (1.0 - s) * start_waist + s * goal_waist
            q = legs(model, (roll_, pitch, yaw_), lower, q)
            path.append(q)
        last = np.array(key)
    return path


def windows(model: RobotModel, path: list[Vector], offsets: Vector, noise: float = 0.0) -> list[Window]:
    """What the sensors would say along a path, accelerations included, one window after the other."""
    data, rng, result = model.data(), np.random.default_rng(0), []
    places, turns = [], []
    for q in path:
        pin.framesForwardKinematics(model.pin, data, q)
        imu = data.oMf[model.frame_id("imu")]
        places.append(imu.translation.copy())
        turns.append(imu.rotation.copy())
    weight = np.zeros((2, 6))
    weight[:, 2] = 0.5 * model.mass * GRAVITY
    for i, q in enumerate(path):
        inside = 0 < i < len(path) - 1
        acceleration = (places[i + 1] - 2 * places[i] + places[i - 1]) / CONFIG.window**2 if inside else np.zeros(3)
        result.append(
            Window(
                t=CONFIG.window * i,
                samples=50,
                q=q[7:] + offsets + noise * rng.standard_normal(model.nj),
                v=np.zeros(model.nj),
                gyro=np.zeros(3),
                accel=turns[i].T @ (acceleration + UP),
                wrenches=weight,
            )
        )
    return result


@pytest.fixture(scope="module")
def paths() -> dict[str, list[Vector]]:
    return {}


def path_of(model: RobotModel, paths: dict[str, list[Vector]]) -> list[Vector]:
    if model.name not in paths:
        paths[model.name] = tour(model)
    return paths[model.name]


def test_jacobians_against_finite_differences(robot: RobotModel) -> None:
    rng, terms = np.random.default_rng(0), ChainTerms(robot)
    q = robot.posture("stand") + 0.05 * rng.standard_normal(robot.nj)
    x = 0.03 * rng.standard_normal(terms.size)
    x[terms.joints.size + 1] = -0.2
    measured, expected = np.array([0.1, 0.2, 9.7]), np.array([0.3, -0.2, 9.9])

    def residual(x: Vector) -> Vector:
        terms.update(q, x)
        return np.concatenate([terms.closure(x)[0], terms.force(x, measured, expected)[0]])

    terms.update(q, x)
    jacobian = np.vstack([terms.closure(x)[1], terms.force(x, measured, expected)[1]])
    step = 1e-6
    numeric = np.array([(residual(x + step * e) - residual(x - step * e)) / (2 * step) for e in np.eye(terms.size)]).T
    np.testing.assert_allclose(jacobian, numeric, atol=1e-7)


def test_recovers_offsets_of_legs_and_whatever_else_is_in_the_chain(
    robot: RobotModel, paths: dict[str, list[Vector]]
) -> None:
    terms = ChainTerms(robot)
    offsets = np.zeros(robot.nj)
    offsets[terms.joints] = 0.03 * np.random.default_rng(3).choice([-1.0, 1.0], terms.joints.size)
    base = replace(Calibration.none(robot), encoder_offsets=np.full(robot.nj, 0.007))
    data = windows(robot, path_of(robot, paths), offsets)
    outcome = calibrate_closed_chain(data, robot, base, CONFIG)
    assert outcome.calibration is not None, outcome.reply.reason
    result = outcome.calibration.encoder_offsets
    np.testing.assert_allclose(result[terms.joints], offsets[terms.joints], atol=3e-4)
    others = np.setdiff1d(np.arange(robot.nj), terms.joints)
    np.testing.assert_array_equal(result[others], 0.007)  # arms are not observable: untouched
    assert outcome.reply.details["joints_untouched"] == others.size and "not observable" in outcome.reply.reason
    assert outcome.reply.details["residual"] < 0.2
    again = calibrate_closed_chain(data, robot, base, CONFIG)
    assert again.reply == outcome.reply


def test_standing_still_does_not_determine_the_offsets(g1: RobotModel) -> None:
    still = windows(g1, [g1.standing_configuration()] * 60, np.zeros(g1.nj))
    reply = calibrate_closed_chain(still, g1, Calibration.none(g1), CONFIG).reply
    assert not reply.accepted and "does not determine" in reply.reason and "left_knee_joint" in reply.reason
    assert reply.details["sigma_left_knee_joint"] > 0.01 and reply.details["singular_min"] < 30.0


def test_without_turning_hip_and_ankle_pitch_cannot_be_distinguished(g1: RobotModel) -> None:
    """Lowering and pitching only: the whole body may tilt about the ankles if the hips tilt back."""
    path = [
        legs(g1, (0.0, 0.3 * np.sin(0.1 * k), 0.0), 0.07 + 0.05 * np.sin(0.05 * k), g1.standing_configuration())
        for k in range(60)
    ]
    reply = calibrate_closed_chain(windows(g1, path, np.zeros(g1.nj)), g1, Calibration.none(g1), CONFIG).reply
    assert not reply.accepted and "hip_pitch" in reply.reason and "ankle_pitch" in reply.reason


def test_soles_that_move_are_noticed(g1: RobotModel, paths: dict[str, list[Vector]]) -> None:
    moved = windows(g1, path_of(g1, paths), np.zeros(g1.nj))
    knee = g1.joint_index("left_knee_joint")
    for i, window in enumerate(moved):
        window.q[knee] += 0.03 * (i % 3)  # no constant offset explains this
    reply = calibrate_closed_chain(moved, g1, Calibration.none(g1), CONFIG).reply
    assert not reply.accepted and "soles slip" in reply.reason


def test_the_posterior_is_honest_about_noise(g1: RobotModel, paths: dict[str, list[Vector]]) -> None:
    """With the noise of the encoders the errors stay within four standard deviations, and shrink as reported."""
    outcome = calibrate_closed_chain(
        windows(g1, path_of(g1, paths), np.zeros(g1.nj), noise=1e-4), g1, Calibration.none(g1), CONFIG
    )
    assert outcome.calibration is not None, outcome.reply.reason
    terms = ChainTerms(g1)
    sigma = np.array([outcome.reply.details[f"sigma_{g1.joint_names[i]}"] for i in terms.joints])
    assert (np.abs(outcome.calibration.encoder_offsets[terms.joints]) < 4.0 * sigma).all()
    assert sigma.max() < CONFIG.chain.sigma_max
