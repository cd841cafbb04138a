"""Momentum observer: Pinocchio as the reference, and known wrenches on motions made with it."""

import numpy as np
import pinocchio as pin
import pytest

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.momentum import generalised_momentum, read_dynamics
from controllers.estimation.observer import ForceObserver
from models.config import default_config, parse_config, read_yaml
from models.constants import GRAVITY
from models.errors import ConfigError
from models.robot_model import RobotModel

DT = 0.001
SOUND, BROKEN = np.zeros(2), np.ones(2)
CONFIG = default_config(EstimatorConfig, "controllers", "estimator")


def test_generalised_momentum_is_that_of_pinocchio(robot: RobotModel) -> None:
    rng = np.random.default_rng(0)
    dynamics, data = read_dynamics(robot, GRAVITY), robot.data()
    for _ in range(5):
        q = pin.integrate(robot.pin, robot.standing_configuration(), 0.5 * rng.normal(size=robot.nv))
        v = rng.normal(size=robot.nv)
        momentum = generalised_momentum(q, v, dynamics)
        mass = np.triu(pin.crba(robot.pin, data, q))
        mass += np.triu(mass, 1).T
        coriolis = pin.computeCoriolisMatrix(robot.pin, data, q, v)
        gravity = pin.computeGeneralizedGravity(robot.pin, data, q)
        np.testing.assert_allclose(momentum.joint_momentum, (mass @ v)[6:], atol=1e-11)
        np.testing.assert_allclose(momentum.joint_rate, (coriolis.T @ v - gravity)[6:], atol=1e-11)
        pin.computeCentroidalMomentum(robot.pin, data, q, v)
        np.testing.assert_allclose(momentum.com_velocity * robot.mass, data.hg.linear, atol=1e-11)
        np.testing.assert_allclose(momentum.angular_momentum, data.hg.angular, atol=1e-11)
        np.testing.assert_allclose(q[:3] + momentum.com, data.com[0], atol=1e-12)
        pin.framesForwardKinematics(robot.pin, data, q)
        for foot in range(2):
            sole = data.oMf[robot.feet[foot].frame_id]
            np.testing.assert_allclose(momentum.sole_rotations[foot], sole.rotation, atol=1e-12)
            np.testing.assert_allclose(q[:3] + momentum.sole_positions[foot], sole.translation, atol=1e-12)


class Scene:
    """A robot that moves as it likes; the joint torques and what the soles bear follow by inverse dynamics.

    Args:
        robot: The robot.
        push: Force in W at the CoM (3,) [N] and moment (3,) [N.m], from 0.5 s on.
        still: Whether the robot stands still.
    """

    def __init__(self, robot: RobotModel, push: np.ndarray, still: bool = False) -> None:
        self.robot, self._push, self._data = robot, push, robot.data()
        rng = np.random.default_rng(1)
        self._start = robot.standing_configuration()
        self._amplitude = (0.0 if still else 0.1) * rng.normal(size=robot.nv)
        self._soles = np.zeros((2, 6))

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Configuration, velocity, joint torques and sole wrenches."""
        robot, w = self.robot, 2.0 * np.pi * 0.7
        # q = q0 (+) a (1 - cos w t): the twist of the base differs from the rate, so by differences
        poses = [pin.integrate(robot.pin, self._start, self._amplitude * (1.0 - np.cos(w * (t + k * 1e-4))))
                 for k in (-1, 0, 1)]  # fmt: skip
        v = pin.difference(robot.pin, poses[0], poses[2]) / 2e-4
        a = (pin.difference(robot.pin, poses[1], poses[2]) - pin.difference(robot.pin, poses[0], poses[1])) / 1e-8
        q = poses[1]
        friction = robot.damping * v[6:] + robot.frictionloss * np.tanh(v[6:] / CONFIG.observer.friction_speed)
        needed = pin.rnea(robot.pin, self._data, q, v, a)
        pin.computeJointJacobians(robot.pin, self._data, q)
        pin.updateFramePlacements(robot.pin, self._data)
        pin.centerOfMass(robot.pin, self._data, q)
        jacobians = [pin.getFrameJacobian(robot.pin, self._data, f.frame_id, pin.LOCAL) for f in robot.feet]
        turn = self._data.oMi[1].rotation
        arm = self._data.com[0] - q[:3]
        push = self._push * (t > 0.5)
        on_base = np.concatenate([turn.T @ push[:3], turn.T @ (push[3:] + np.cross(arm, push[:3]))])
        needed[:6] -= on_base
        # Six rows of the base, twelve wrench components: the least wrenches that do it.
        stacked = np.hstack([j[:, :6].T for j in jacobians])
        wrenches = (np.linalg.pinv(stacked) @ needed[:6]).reshape(2, 6)
        tau = needed[6:] - sum(j[:, 6:].T @ w for j, w in zip(jacobians, wrenches, strict=True)) + friction
        return q, v, tau, wrenches


def run(scene: Scene, observer: ForceObserver, duration: float, start: float = 0.0) -> None:
    if start == 0.0:
        q, v, tau, wrenches = scene.at(0.0)
        observer.reset(q, v, tau, wrenches, SOUND)
    for k in range(1, round(duration / DT) + 1):
        q, v, tau, wrenches = scene.at(start + k * DT)
        observer.update(q, v, tau, wrenches, SOUND, DT)


@pytest.mark.parametrize("axis", range(6))
def test_a_known_push_on_a_moving_robot(robot: RobotModel, axis: int) -> None:
    push = np.zeros(6)
    push[axis] = 0.2 * robot.mass * GRAVITY if axis < 3 else 5.0
    push[(axis + 1) % 3] += 0.1 * robot.mass * GRAVITY  # a moment alone stays in the dead-band
    observer = ForceObserver(robot, CONFIG.observer, CONFIG.gravity)
    scene = Scene(robot, push)
    run(scene, observer, 0.5)
    assert not observer.push.active
    np.testing.assert_array_equal(observer.push.force, 0.0)
    run(scene, observer, 0.3, start=0.5)
    seen = observer.push
    assert seen.active
    np.testing.assert_allclose(seen.force, push[:3], atol=0.004 * observer.weight)
    np.testing.assert_allclose(seen.moment, push[3:], atol=0.004 * observer.weight)
    np.testing.assert_allclose(seen.impulse, 0.3 * push[:3], rtol=0.12, atol=0.003 * observer.weight)


def test_sole_wrenches_come_from_the_leg_torques_alone(robot: RobotModel) -> None:
    """Without a foot sensor, and whatever pushes the upper body."""
    push = np.array([0.1, -0.05, 0.1, 0.0, 0.0, 0.0]) * robot.mass * GRAVITY
    scene, observer = Scene(robot, push), ForceObserver(robot, CONFIG.observer, CONFIG.gravity)
    nothing = np.zeros((2, 6))
    q, v, tau, wrenches = scene.at(0.0)
    observer.reset(q, v, tau, nothing, BROKEN)
    np.testing.assert_allclose(observer.estimated[:, 2], wrenches[:, 2], atol=0.05 * observer.weight)  # it accelerates
    for k in range(1, 1000):
        q, v, tau, wrenches = scene.at(k * DT)
        observer.update(q, v, tau, nothing, BROKEN, DT)
        if k > 600:
            np.testing.assert_allclose(observer.estimated[:, :3], wrenches[:, :3], atol=0.04 * observer.weight)
            np.testing.assert_allclose(observer.estimated[:, 3:], wrenches[:, 3:], atol=0.01 * observer.weight)
    np.testing.assert_allclose(observer.push.force, push[:3], atol=0.02 * observer.weight)


def test_a_lasting_small_force_is_learnt_and_a_large_one_is_not(g1: RobotModel) -> None:
    weight = g1.mass * GRAVITY
    for share, expected in ((0.8 * CONFIG.observer.dead_band, 0.0), (0.2, 0.2)):
        observer = ForceObserver(g1, CONFIG.observer, CONFIG.gravity)
        scene = Scene(g1, np.array([share * weight, 0.0, 0.0, 0.0, 0.0, 0.0]), still=True)
        q, v, tau, wrenches = scene.at(0.0)
        observer.reset(q, v, tau, wrenches, SOUND)
        q, v, tau, wrenches = scene.at(1.0)
        for _ in range(round(5.0 * CONFIG.observer.offset_time / DT)):
            observer.update(q, v, tau, wrenches, SOUND, DT)
        assert observer.state.push[0] / weight == pytest.approx(expected, abs=0.002)
        assert observer.push.active == (expected > 0.0)


def test_detection_has_hysteresis_and_ends(g1: RobotModel) -> None:
    config = CONFIG.observer
    observer = ForceObserver(g1, config, CONFIG.gravity)
    between = 0.5 * (config.detect_on + config.detect_off) * observer.weight
    still = Scene(g1, np.zeros(6), still=True)
    q, v, tau, wrenches = still.at(0.0)
    observer.reset(q, v, tau, wrenches, SOUND)

    def feel(force: float, duration: float) -> bool:
        less = wrenches.copy()
        for foot in range(2):  # what the soles lack, something else bears
            less[foot, 2] -= 0.5 * force
        for _ in range(round(duration / DT)):
            observer.update(q, v, tau, less, SOUND, DT)
        return observer.push.active

    assert not feel(between, 0.3)
    assert not feel(0.15 * observer.weight, 0.5 * config.on_time)
    assert not feel(0.0, 0.3)
    assert feel(0.15 * observer.weight, 0.3)
    assert feel(between, 0.3)
    assert observer.push.impulse[2] > 0.0
    assert not feel(0.0, 0.3 + config.off_time)
    np.testing.assert_array_equal(observer.push.impulse, 0.0)
    assert not feel(between, 0.3)


def test_centroidal_state_of_a_robot_at_rest(robot: RobotModel) -> None:
    observer, scene = ForceObserver(robot, CONFIG.observer, CONFIG.gravity), Scene(robot, np.zeros(6), still=True)
    q, v, tau, wrenches = scene.at(0.0)
    v[:3] = 0.1, -0.05, 0.0
    observer.reset(q, v, tau, wrenches, SOUND)
    state = observer.centroidal
    com = pin.centerOfMass(robot.pin, robot.data(), q)
    np.testing.assert_allclose(state.com, com, atol=1e-12)
    np.testing.assert_allclose(state.com_velocity, [0.1, -0.05, 0.0], atol=1e-12)
    omega = np.sqrt(GRAVITY / com[2])
    np.testing.assert_allclose(state.dcm, com[:2] + np.array([0.1, -0.05]) / omega, atol=1e-9)
    np.testing.assert_allclose(state.zmp, com[:2], atol=1e-6)  # at rest the ZMP is below the CoM


def test_thresholds_in_the_wrong_order_are_refused(root: object) -> None:
    for section, key, value in (
        ("observer", "detect_off", 0.5),
        ("foot_sensors", "swing_load", 0.5),
        ("foot_sensors", "scheduled_time", 0.5),
    ):
        data = read_yaml(root / "controllers" / "config" / "estimator.yaml")  # type: ignore[operator]
        data[section][key] = value
        with pytest.raises(ConfigError, match=rf"{section}.*{key}"):
            parse_config(EstimatorConfig, data, "test")
