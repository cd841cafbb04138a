"""Any controller in the tests of poise: what it gets, how it acts, and the baseline that stands and falls."""

from typing import Any

import numpy as np
import pytest

from benchmarks.core import contender
from benchmarks.core.benchmark import settings
from benchmarks.core.contender import ContenderLoop
from benchmarks.stability import push, terrain, walk_cases
from benchmarks.stability.push_bounds import torque_bound
from benchmarks.stability.stand_still import StandStill
from models.errors import ConfigError
from models.robot_model import RobotModel
from models.types import JointCommand, SensorData

BASELINE = "benchmarks.stability.stand_still:StandStill"
CONFIG = settings(push.PushConfig, "push")


class Posture:
    """Leaves the standing posture to the drivers, and keeps what it receives."""

    torque_controlled = False

    def __init__(self) -> None:
        self.calls: list[Any] = []

    def reset(self, model: RobotModel, seed: int) -> None:
        """Take the torques of standing."""
        self.still = StandStill()
        self.still.reset(model, seed)
        self.calls.append(seed)

    def set_velocity(self, forward: float, left: float, turn: float) -> None:
        """Keep it."""
        self.calls.append((forward, left, turn))

    def step(self, sensors: SensorData, dt: float) -> JointCommand:
        """Posture and torques of standing."""
        self.calls.append(sensors.t)
        return JointCommand(self.still._posture, np.zeros(len(sensors.q)), self.still._torque)


@pytest.mark.long
def test_the_baseline_stands_and_takes_a_small_push_only(g1: RobotModel) -> None:
    loop = ContenderLoop(BASELINE, "g1", seed=1)
    loop.run(1.5)
    assert not loop.fallen and loop.fall_reason == "" and loop.foot_slip.max() < 0.005
    forward = np.array([1.0, 0.0, 0.0])
    ankle, _ = push.bound_at_rest(loop, forward, CONFIG)
    assert 0.0 < torque_bound(loop.robot, loop.truth.q, forward, CONFIG.duration) <= 1.05 * ankle
    for share, falls in ((0.2, False), (2.0, True)):
        loop.reset(1)
        loop.run(0.5)
        loop.apply_push((share * ankle, 0.0, 0.0), CONFIG.duration)
        loop.run(3.0)
        assert loop.fallen is falls, loop.fall_reason


def test_two_runs_of_a_seed_are_the_same() -> None:
    loop = ContenderLoop(BASELINE, "g1", seed=3)
    loop.run(0.3)
    first = loop.truth.q.copy()
    loop.reset(3)
    loop.run(0.3)
    np.testing.assert_array_equal(loop.truth.q, first)
    loop.reset(4)
    loop.run(0.3)
    assert (loop.truth.q != first).any()


def test_the_drivers_execute_targets_and_commands_come_late(monkeypatch: pytest.MonkeyPatch) -> None:
    made = Posture()
    monkeypatch.setattr(contender, "load", lambda name: made)
    loop = ContenderLoop("any", "g1", seed=2, delay_s=0.004, record_period_s=0.01)
    assert made.calls[0] == 2 and loop._lockstep._delay_ticks == 4
    loop.set_velocity(0.1, 0.0, 0.2)
    loop.run(0.1)
    assert made.calls.count((0.1, 0.0, 0.2)) == 1
    stamps = [word for word in made.calls if isinstance(word, float)]
    np.testing.assert_allclose(np.diff(stamps[-50:]), 0.001, atol=1e-9)
    assert loop.log.tau.shape[1] == loop.robot.nj and len(loop.log) == len(loop.log.true_v) > 5
    assert len(loop._lockstep._queue) == 4  # what it has answered and the drivers do not have yet


@pytest.mark.long
def test_speed_and_terrain_tests_run_with_a_contender() -> None:
    """The baseline does not walk: it survives neither, and is scored like everybody."""
    case = walk_cases.measure(
        "steady", scenario="forward", robot="g1", seed=0, command=(0.3, 0.0, 0.0), duration=4.0, contender=BASELINE
    )
    assert not case["fell"] and case["moments"] == {}
    assert case["speed_error"] == pytest.approx(1.0, abs=0.05)
    rough = terrain.walk("g1", 0, "friction", BASELINE)
    assert not rough["survived"] and "moments" not in rough and abs(rough["distance"]) < 0.05


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("no.such.module:Class", "no.such"),
        ("benchmarks.stability.stand_still:Runner", "Runner"),
        ("benchmarks.stability.stand_still", "module:Class"),
        ("models.errors:PoiseError", "has no torque_controlled, reset, set_velocity, step"),
    ],
)
def test_what_is_no_contender_is_refused_by_name(name: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        contender.load(name)
