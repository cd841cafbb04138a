"""Calibration of IMU, feet, and encoders in a jig, on made-up samples: what is found and what is refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from controllers.calibration.session import CalibrationSession
from controllers.calibration.windows import Outcome
from models.calibration import Calibration
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import SensorData, Vector

DT = 0.002


class Feed:
    """Made-up samples of one robot, with a little noise."""

    def __init__(self, model: RobotModel, what: str) -> None:
        self.model = model
        self.session = CalibrationSession(model)
        assert self.session.start(what).accepted
        self.rng = np.random.default_rng(0)
        self.k = 0
        self.q = model.posture("stand")
        self.gyro, self.accel = np.zeros(3), np.array([0.0, 0.0, GRAVITY])
        self.wrenches = np.zeros((2, 6))

    def add(self, time: float, **channels: Callable[[float], Vector]) -> Feed:
        """Samples for a time [s]; a channel may be a function of the time since its start."""
        nj = self.model.nj
        for i in range(round(time / DT)):
            value = {name: function(i * DT) for name, function in channels.items()}
            sample = SensorData(
                t=self.k * DT,
                q=value.get("q", self.q),
                v=value.get("v", np.zeros(nj)) + 0.01 * self.rng.standard_normal(nj),
                tau=np.zeros(nj),
                gyro=value.get("gyro", self.gyro) + 0.005 * self.rng.standard_normal(3),
                accel=value.get("accel", self.accel) + 0.05 * self.rng.standard_normal(3),
                wrenches=value.get("wrenches", self.wrenches) + 0.5 * self.rng.standard_normal((2, 6)),
            )
            self.session.add(sample)
            self.k += 1
        return self

    def finish(self, base: Calibration | None = None) -> Outcome:
        return self.session.finish(base or Calibration.none(self.model))


def refused(outcome: Outcome, *words: str) -> dict[str, float]:
    assert not outcome.reply.accepted and outcome.calibration is None
    for word in words:
        assert word in outcome.reply.reason, outcome.reply.reason
    return outcome.reply.details


def found(outcome: Outcome) -> Calibration:
    assert outcome.reply.accepted and outcome.calibration is not None, outcome.reply.reason
    return outcome.calibration


def loads(model: RobotModel, left: float, right: float) -> Vector:
    """Wrenches that carry shares of the weight (2, 6)."""
    wrenches = np.zeros((2, 6))
    wrenches[:, 2] = np.array([left, right]) * model.mass * GRAVITY
    return wrenches


def test_imu_finds_the_gyro_bias_and_what_gravity_shows(g1: RobotModel) -> None:
    feed = Feed(g1, "imu")
    up = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
    feed.gyro, feed.accel = np.array([0.05, -0.05, 0.02]), (GRAVITY + 0.1) * up
    outcome = feed.add(2.0).finish()
    result = found(outcome)
    np.testing.assert_allclose(result.gyro_bias, feed.gyro, atol=5e-4)
    np.testing.assert_allclose(result.accel_bias, 0.1 * up, atol=5e-3)
    details = outcome.reply.details
    assert details["samples"] == 1000 and abs(details["accel_norm"] - 9.91) < 5e-3
    np.testing.assert_allclose([details[f"gravity_{a}"] for a in "xyz"], up, atol=1e-3)
    assert not result.encoder_offsets.any() and not result.wrench_offsets.any() and (result.force_gains == 1.0).all()


def test_imu_keeps_what_the_base_says_of_other_sensors(g1: RobotModel) -> None:
    base = Calibration("g1", np.ones(3), np.ones(3), np.full(g1.nj, 0.01), np.full((2, 6), 2.0), np.full(2, 1.1))
    result = found(Feed(g1, "imu").add(2.0).finish(base))
    np.testing.assert_array_equal(result.encoder_offsets, base.encoder_offsets)
    np.testing.assert_array_equal(result.wrench_offsets, base.wrench_offsets)
    assert np.abs(result.gyro_bias).max() < 1e-3


def test_imu_takes_slow_leaning_off_the_bias_when_the_feet_stand(g1: RobotModel) -> None:
    """Both ankles let the robot lean forward at 4 mrad/s: the gyro feels it, and the encoders know of it."""
    lean = np.zeros(g1.nj)
    lean[[g1.joint_index("left_ankle_pitch_joint"), g1.joint_index("right_ankle_pitch_joint")]] = -0.004
    bias, rate = np.array([0.01, 0.05, -0.02]), np.array([0.0, 0.004, 0.0])
    for standing, expected in ((True, bias), (False, bias + rate)):
        feed = Feed(g1, "imu")
        feed.gyro = bias + rate
        feed.wrenches = loads(g1, 0.5, 0.5) if standing else feed.wrenches
        outcome = feed.add(2.0, q=lambda t: g1.posture("stand") + lean * t).finish()
        np.testing.assert_allclose(found(outcome).gyro_bias, expected, atol=6e-4)


def test_imu_refuses_a_moving_robot(g1: RobotModel) -> None:
    joint = g1.joint_index("waist_yaw_joint")
    velocity = np.zeros(g1.nj)
    velocity[joint] = 0.2
    details = refused(Feed(g1, "imu").add(2.0, v=lambda t: velocity).finish(), "moves", "waist_yaw_joint", "0.2")
    assert details["joint_speed"] > 0.19
    creeping = np.zeros(g1.nj)
    creeping[joint] = 0.02
    refused(Feed(g1, "imu").add(2.0, q=lambda t: creeping * t).finish(), "waist_yaw_joint", "has moved by")
    wobble = np.array([0.0, 0.1, 0.0])
    refused(Feed(g1, "imu").add(2.0, gyro=lambda t: wobble * np.sin(9.0 * t)).finish(), "angular rate varies")
    refused(
        Feed(g1, "imu").add(2.0, accel=lambda t: np.array([np.sin(9.0 * t), 0.0, GRAVITY])).finish(), "force varies"
    )
    refused(Feed(g1, "imu").add(2.0, gyro=lambda t: np.array([0.0, 0.0, 0.006 * t])).finish(), "turns", "drifts")


def test_imu_refuses_what_is_not_gravity_or_not_plausible(g1: RobotModel) -> None:
    feed = Feed(g1, "imu")
    feed.accel = np.array([0.0, 0.0, 9.005])
    refused(feed.add(2.0).finish(), "not gravity", "9.00")
    feed = Feed(g1, "imu")
    feed.gyro = np.array([0.0, 0.25, 0.0])
    refused(feed.add(2.0).finish(), "implausible", "gyro_bias.y", "0.25")


def test_too_few_samples_are_refused_with_their_number(g1: RobotModel) -> None:
    assert refused(Feed(g1, "imu").add(0.5).finish(), "too few samples: 250")["time"] == pytest.approx(0.5)
    refused(Feed(g1, "imu").finish(), "too few samples")
    refused(Feed(g1, "feet").add(0.2).finish(), "neither in the air")
    refused(Feed(g1, "joints").add(0.2).finish(), "missing: zero")
    refused(Feed(g1, "joints").add(0.5, wrenches=lambda t: loads(g1, 0.5, 0.5)).finish(), "10 usable windows")


def test_unusable_samples_are_left_out_and_counted(g1: RobotModel) -> None:
    feed = Feed(g1, "imu")
    feed.gyro = np.array([0.05, 0.0, 0.0])
    feed.add(2.0, gyro=lambda t: np.full(3, np.nan) if 0.1 < t < 0.2 else feed.gyro)
    feed.k -= 50
    feed.gyro = np.array([5.0, 5.0, 5.0])
    feed.add(0.1)  # stamps that were there already
    outcome = feed.finish()
    np.testing.assert_allclose(found(outcome).gyro_bias, [0.05, 0.0, 0.0], atol=5e-4)
    assert outcome.reply.details["samples_unusable"] == pytest.approx(99, abs=2)


def test_session_refuses_unknown_busy_and_idle(g1: RobotModel) -> None:
    session = CalibrationSession(g1)
    assert "no calibration is running" in session.finish(Calibration.none(g1)).reply.reason
    assert not session.start("toes").accepted
    assert session.start("imu").accepted
    busy = session.start("feet")
    assert not busy.accepted and "'imu' is being calibrated" in busy.reason
    session.cancel()
    assert session.start("feet").accepted


@pytest.mark.parametrize("standing", [True, False])
def test_a_robot_without_foot_sensors_is_calibrated_as_it_stands_or_hangs(standing: bool) -> None:
    model = RobotModel.load("g1_hardware")
    feed = Feed(model, "imu")
    feed.wrenches, feed.gyro = np.full((2, 6), np.nan), np.array([0.05, -0.05, 0.02])
    feed.session.cancel()
    assert not feed.session.start("feet", standing=standing).accepted
    assert feed.session.start("imu", standing=standing).accepted
    np.testing.assert_allclose(found(feed.add(2.0).finish()).gyro_bias, feed.gyro, atol=2e-3)
    assert feed.session.start("joints", standing=standing).accepted
    refused(feed.add(0.5).finish(), "10 usable windows" if standing else "missing: zero")


def jig(
    model: RobotModel, offsets: Vector, *, times: tuple[float, float] = (0.6, 0.6), second: Vector | None = None
) -> Feed:
    feed = Feed(model, "joints")
    extras = (offsets, offsets if second is None else second)
    for name, time, extra in zip(model.profile.jig_postures, times, extras, strict=True):
        feed.q = model.posture(name) + extra
        feed.add(time)
    return feed


def test_jig_finds_the_offsets_of_all_joints(robot: RobotModel) -> None:
    offsets = np.random.default_rng(1).uniform(-0.05, 0.05, robot.nj)
    outcome = jig(robot, offsets).finish()
    np.testing.assert_allclose(found(outcome).encoder_offsets, offsets, atol=1e-9)
    assert outcome.reply.details[robot.joint_names[3]] == pytest.approx(offsets[3])


def test_jig_refuses_missing_wrong_and_inconsistent_postures(g1: RobotModel) -> None:
    none = np.zeros(g1.nj)
    refused(jig(g1, none, times=(0.6, 0.2)).finish(), "missing: stand", "not at rest for long enough")
    far = none.copy()
    far[g1.joint_index("left_elbow_joint")] = 0.3
    refused(jig(g1, none, second=far).finish(), "missing: stand", "left_elbow_joint", "0.300")
    near = none.copy()
    near[g1.joint_index("left_elbow_joint")] = 0.02
    refused(jig(g1, none, second=near).finish(), "left_elbow_joint", "differ by 0.0200")
    feed = Feed(g1, "joints")
    for name in g1.profile.jig_postures:
        feed.q = g1.posture(name)
        feed.add(1.0, q=lambda t, q=feed.q: q + 0.04 * t)
    refused(feed.finish(), "moves in posture")


def test_joints_refuse_a_robot_that_neither_stands_nor_hangs(g1: RobotModel) -> None:
    details = refused(Feed(g1, "joints").add(1.0, wrenches=lambda t: loads(g1, 0.2, 0.2)).finish(), "neither standing")
    assert details["load"] == pytest.approx(0.4 * details["weight"], rel=0.02)


def test_feet_in_the_air_give_offsets(g1: RobotModel) -> None:
    offsets = np.array([[15.0, -15.0, 15.0, 1.0, -0.5, 0.2], [-15.0, 15.0, -15.0, 0.3, 0.1, -0.7]])
    outcome = Feed(g1, "feet").add(1.0, wrenches=lambda t: offsets).finish()
    result = found(outcome)
    np.testing.assert_allclose(result.wrench_offsets, offsets, atol=0.1)
    assert (result.force_gains == 1.0).all()
    assert outcome.reply.details["right_fz"] == pytest.approx(-15.0, abs=0.1)


def test_feet_standing_give_gains(g1: RobotModel) -> None:
    """The sensors read 4 % too much and 6 % too little, with offsets that are known from the air."""
    offset = np.zeros((2, 6))
    offset[:, 2] = [10.0, -5.0]
    base = Calibration("g1", np.zeros(3), np.zeros(3), np.zeros(g1.nj), offset, np.ones(2))

    def read(left: float) -> Vector:
        wrenches = loads(g1, left, 1.0 - left)
        wrenches[:, 2] *= [1.04, 0.94]
        return wrenches + offset

    feed = Feed(g1, "feet")
    for left in (0.5, 0.75, 0.25):
        feed.add(0.6, wrenches=lambda t, left=left: read(left))
    np.testing.assert_allclose(found(feed.finish(base)).force_gains, [1 / 1.04, 1 / 0.94], rtol=2e-3)
    outcome = Feed(g1, "feet").add(0.6, wrenches=lambda t: read(0.5)).finish(base)
    result = found(outcome)
    assert result.force_gains[0] == result.force_gains[1] == pytest.approx(1 / 0.99, rel=2e-3)
    assert "together" in outcome.reply.reason


def test_feet_in_one_go_from_the_air_to_the_floor(g1: RobotModel) -> None:
    offset = np.zeros((2, 6))
    offset[:, 2] = 8.0
    feed = Feed(g1, "feet").add(1.0, wrenches=lambda t: offset)
    feed.add(0.3, wrenches=lambda t: offset + loads(g1, 0.3, 0.1))
    for left in (0.7, 0.3):
        feed.add(0.6, wrenches=lambda t, left=left: offset + 1.05 * loads(g1, left, 1.0 - left))
    result = found(feed.finish())
    np.testing.assert_allclose(result.wrench_offsets[:, 2], 8.0, atol=0.1)
    np.testing.assert_allclose(result.force_gains, 1 / 1.05, rtol=2e-3)


def test_feet_refuse_what_is_neither_air_nor_weight_nor_rest(g1: RobotModel) -> None:
    refused(Feed(g1, "feet").add(1.0, wrenches=lambda t: loads(g1, 0.3, 0.1)).finish(), "131 N", "neither in the air")
    shaking = Feed(g1, "feet").add(1.0, wrenches=lambda t: np.full((2, 6), 20.0 * np.sin(4.0 * t)))
    refused(shaking.finish(), "varies by")
    bouncing = Feed(g1, "feet").add(1.0, wrenches=lambda t: loads(g1, 0.5, 0.5) * (1.0 + 0.2 * np.sin(6.0 * t)))
    refused(bouncing.finish(), "not at rest")
    velocity = np.full(g1.nj, 0.5)
    standing = Feed(g1, "feet").add(1.0, wrenches=lambda t: loads(g1, 0.5, 0.5), v=lambda t: velocity)
    refused(standing.finish(), "moves")
    hanging = Feed(g1, "feet").add(1.0, v=lambda t: velocity)
    refused(hanging.finish(), "moves in the air")
    heavy = np.zeros((2, 6))
    heavy[0, 0] = 150.0
    refused(Feed(g1, "feet").add(1.0, wrenches=lambda t: heavy).finish(), "implausible", "left force_offset.x")


def test_same_samples_same_answer(g1: RobotModel) -> None:
    first, second = (Feed(g1, "imu").add(2.0).finish() for _ in range(2))
    assert first.reply == second.reply
    np.testing.assert_array_equal(found(first).gyro_bias, found(second).gyro_bias)
