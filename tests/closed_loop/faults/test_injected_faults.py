"""Faults injected while the robot stands: what it survives, and what damps it with a reason."""

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from bridge.plants.fault_plan import Fault
from controllers.estimation.feet import FootSensorState
from models.robot_model import RobotModel
from models.types import Mode

KNEE = "motor:left_knee_joint"


@pytest.fixture(scope="module")
def loop(g1: RobotModel) -> ClosedLoop:
    return ClosedLoop(g1, seed=3, record=False)


@pytest.fixture
def standing(loop: ClosedLoop) -> ClosedLoop:
    loop.reset()
    return loop


def test_a_short_drop_out_and_a_dead_foot_sensor_are_survived(standing: ClosedLoop) -> None:
    loop, height = standing, standing.truth.q[2]
    loop.inject([Fault("foot:left", "stuck", value=0.0), Fault("imu", "off", start=0.2, end=0.22)])
    loop.run(0.6)
    assert loop.mode is Mode.STAND and not loop.fallen
    assert loop.truth.q[2] == pytest.approx(height, abs=0.003)
    assert loop.estimator.health.invalid_imu == 15  # the last sample stands in for 5 ms
    assert loop.estimator.health.foot_sensors[0] is FootSensorState.CONTRADICTED
    texts = [text for _, text in loop.events]
    assert texts[-3].startswith("injected: foot:left stuck (value 0.0); imu off")
    assert [text.split(":")[0] for text in texts[-2:]] == ["fault begins", "fault ends"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{target: imu, kind: off, end: 0.1}", "no usable samples of the IMU"),
        ("{target: stamps, kind: stuck, end: 0.1}", "no usable samples of the IMU"),
        ("{target: stamps, kind: wrong, offset: -0.2, end: 0.1}", "no usable samples of the IMU"),
    ],
)
def test_samples_unusable_for_long_damp_with_the_reason(standing: ClosedLoop, text: str, reason: str) -> None:
    standing.inject(text)
    standing.run(0.1)
    assert standing.mode is Mode.DAMP
    assert reason in "; ".join(standing.faults)


@pytest.mark.parametrize(("length", "mode"), [(0.01, Mode.STAND), (0.2, Mode.DAMP)])
def test_joint_states_that_do_not_come(standing: ClosedLoop, length: float, mode: Mode) -> None:
    """Without them no command is computed: the drivers go on with the last one for a while, then they damp."""
    before = standing.estimator.health.steps
    standing.inject(Fault("joint_states", "off", end=length))
    standing.run(0.2)
    assert standing.estimator.health.steps - before == 200 - round(1000 * length)
    assert standing.mode is mode
    assert not standing.fallen


def test_a_dead_motor_gives_no_torque_whatever_is_commanded(standing: ClosedLoop) -> None:
    loop, knee = standing, standing.robot.joint_index("left_knee_joint")
    assert abs(loop.truth.tau[knee]) > 5.0  # [N.m]
    loop.inject(Fault(KNEE, "off", end=0.01))
    loop.run(0.009)
    assert loop.truth.tau[knee] == 0.0
    assert abs(loop.result.command.tau[knee]) > 5.0
    loop.clear_faults()
    loop.run(0.5)
    assert abs(loop.truth.tau[knee]) > 5.0
    assert loop.mode is Mode.STAND and not loop.fallen


def test_a_run_with_a_plan_repeats_bit_by_bit(g1: RobotModel) -> None:
    """From the release on, at every reset anew; what was injected by hand is gone then."""
    plan = [Fault("imu", "garbage", start=0.02, end=0.03), Fault(KNEE, "garbage", scale=0.2, end=0.05)]
    loop = ClosedLoop(g1, seed=3, record=False, faults=plan)
    ends = []
    for _ in range(2):
        assert loop.plant.faults.injected == tuple(plan)
        loop.inject(Fault("imu", "off", start=5.0))
        loop.run(0.1)
        ends.append(loop.truth.q)
        loop.reset()
    np.testing.assert_array_equal(*ends)


def test_a_walk_ends_when_the_scanner_says_nothing(g1: RobotModel) -> None:
    loop = ClosedLoop(g1, seed=3, record=False, obstacle_stop=True)
    assert loop.command("forward").accepted
    loop.run(0.8)
    guard = loop._guard
    assert guard is not None and not guard.reason
    loop.inject(Fault("scan", "off"))
    loop.run(1.0)
    assert "scan" in guard.reason
    assert not loop.fallen
