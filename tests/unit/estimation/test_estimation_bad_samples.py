"""What the estimator makes of samples that are stale or not finite, and of a start that it cannot use."""

import numpy as np
import pytest
from msgspec.structs import replace

from controllers.estimation.estimator import StateEstimator
from controllers.estimation.samples import EstimatorHealth
from models.errors import MessageError
from models.robot_model import RobotModel
from tests.known_motion import DT, LIFT_AT, PUSH_AT, between, motion, robot_of, run, sensors_of


def coasting_run(
    estimator: StateEstimator, seed: int, corrupt: dict[str, object], at: float, length: float
) -> np.ndarray:
    """Errors of the base velocity until a foot is lifted, when part of each sample in a window is spoiled (n, 3)."""
    robot = robot_of(estimator)
    truth = motion(robot)
    sensors = sensors_of(robot, truth, seed)[between(0.0, LIFT_AT)]
    window = between(at, at + length)
    for k in range(window.start, window.stop):
        sensors[k] = replace(sensors[k], **{n: np.full_like(getattr(sensors[k], n), x) for n, x in corrupt.items()})
    states = run(estimator, sensors)
    for state in states:
        assert np.isfinite(state.q).all()
        assert np.isfinite(state.v).all()
        assert np.isfinite(state.tau).all()
    return np.array([s.v[:3] for s in states]) - truth.v[: len(states), :3]


@pytest.mark.parametrize(
    ("part", "counter"),
    [("q", "invalid_joints"), ("v", "invalid_joints"), ("tau", "invalid_torques"), ("gyro", "invalid_imu"),
     ("accel", "invalid_imu"), ("wrenches", "invalid_feet")],
)  # fmt: skip
@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_values_that_are_not_finite_are_bridged_and_counted(
    estimator: StateEstimator, part: str, counter: str, value: float
) -> None:
    error = coasting_run(estimator, 0, {part: value}, at=PUSH_AT + 0.05, length=0.02)
    health = estimator.health
    expected = EstimatorHealth(steps=health.steps, gated=health.gated, friction=health.friction)
    setattr(expected, counter, 20)
    assert estimator.health == expected
    assert np.abs(error).max() < 0.1  # 20 ms in the middle of a push of 4 m/s^2
    assert np.abs(error[between(PUSH_AT + 0.3, LIFT_AT)]).max() < 0.02


def test_stale_samples_coast_and_time_goes_on(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    sensors = sensors_of(robot, motion(robot), 0)
    estimator.reset(sensors[0])
    for sample in sensors[1:300]:
        last = estimator.step(sample, DT)
    for k in range(20):  # duplicates, then one from the past, then one without a stamp
        stale = sensors[299] if k < 18 else replace(sensors[320], t=sensors[100].t if k == 18 else np.nan)
        state = estimator.step(stale, DT)
        assert state.t == pytest.approx(last.t + (k + 1) * DT)
    assert estimator.health.stale == 20
    assert estimator.health.coasting == pytest.approx(20 * DT)
    state = estimator.step(sensors[320], DT)
    assert state.t == sensors[320].t
    assert estimator.health.coasting == 0.0
    assert np.abs(state.v[:3] - motion(robot).v[320, :3]).max() < 0.03


@pytest.mark.parametrize("dt", [0.0, -0.001, np.nan, np.inf])
def test_unusable_step_changes_nothing(estimator: StateEstimator, dt: float) -> None:
    sensors = sensors_of(robot_of(estimator), motion(robot_of(estimator)), 0)
    before = estimator.reset(sensors[0])
    after = estimator.step(sensors[1], dt)
    np.testing.assert_array_equal(after.q, before.q)
    np.testing.assert_array_equal(after.v, before.v)
    assert estimator.health.stale == 1


@pytest.mark.parametrize("part", ["q", "v", "tau", "gyro", "accel", "wrenches"])
def test_unusable_first_sample_is_refused_by_name(estimator: StateEstimator, part: str) -> None:
    robot = robot_of(estimator)
    sample = sensors_of(robot, motion(robot), None)[0]
    value = getattr(sample, part)
    if part != "wrenches":  # a robot without foot sensors starts on its leg torques
        with pytest.raises(MessageError, match=rf"sensors\.{part}: not finite"):
            estimator.reset(replace(sample, **{part: np.full_like(value, np.nan)}))
    with pytest.raises(MessageError, match=rf"sensors\.{part}: shape"):
        estimator.reset(replace(sample, **{part: value[:1]}))


def test_moving_start_and_missing_reset_are_refused(g1: RobotModel) -> None:
    estimator = StateEstimator(g1)
    sample = sensors_of(g1, motion(g1), None)[0]
    with pytest.raises(MessageError, match="reset"):
        estimator.step(sample, DT)
    with pytest.raises(MessageError, match="not at rest"):
        estimator.reset(replace(sample, accel=1.5 * sample.accel))
    with pytest.raises(MessageError, match=r"sensors\.t"):
        estimator.reset(replace(sample, t=np.nan))


def test_a_stamp_that_leaps_ahead_is_refused_unless_the_samples_go_on_from_there(estimator: StateEstimator) -> None:
    robot = robot_of(estimator)
    sensors = sensors_of(robot, motion(robot), 0)[:120]
    estimator.reset(sensors[0])
    for sample in sensors[1:50]:
        estimator.step(sample, DT)
    state = estimator.step(replace(sensors[50], t=sensors[50].t + 3600.0), DT)
    assert estimator.health.stale == 1 and state.t == pytest.approx(sensors[50].t)
    for sample in sensors[51:60]:
        state = estimator.step(sample, DT)
        assert state.t == sample.t
    assert estimator.health.stale == 1  # one wrong stamp has cost one sample
    for sample in sensors[60:]:
        state = estimator.step(replace(sample, t=sample.t + 1.0), DT)
    assert estimator.health.stale == 2 and state.t == sensors[-1].t + 1.0  # the clock has been set
