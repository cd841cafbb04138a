"""Gains that change while the robot stands: where they end, and that nothing jumps on the way."""

import numpy as np
import pytest

from benchmarks.core.loops import TorqueSteps
from bridge.closed_loop import ClosedLoop
from controllers.balance import tuning
from controllers.balance.controller import BalanceController
from controllers.balance.tuning import RAMP_TIME, TUNABLE, Tuning, configured
from models.errors import CommandError
from models.robot_model import RobotModel

DT = 0.001


class Tuned:
    """A robot that stands, and the gains of its law."""

    def __init__(self, model: RobotModel, *, noise: bool) -> None:
        self.law = BalanceController(model)
        self.loop = ClosedLoop(model, controller=self.law, sensor_noise=noise, record=False)
        self.tuning = Tuning(self.law)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.tuning.step(DT)
            self.loop.run(DT)

    def change_all(self, factor: float) -> None:
        for name in TUNABLE:
            self.tuning.set(name, factor * configured(name, self.law.config, self.law.whole_body.config))


def test_a_gain_goes_to_its_value_in_the_time_of_the_ramp(g1: RobotModel) -> None:
    law = BalanceController(g1)
    tuned, posture = Tuning(law), law.whole_body.tasks["posture"]
    before = posture.weight.copy()
    leg = g1.feet[0].joint_ids_v[0] - 6
    assert before[leg] < before.max()  # the legs' posture weighs less
    tuned.set("whole_body.posture.weight", 1.5 * before.max())
    tuned.step(0.5 * RAMP_TIME)
    np.testing.assert_allclose(posture.weight, 1.25 * before)
    tuned.step(0.6 * RAMP_TIME)
    np.testing.assert_allclose(posture.weight, 1.5 * before)
    assert not tuned.moving
    tuned.set("balance.dcm_gain", 4.0)
    tuned.step(0.1)
    tuned.set("balance.dcm_gain", 5.0)  # back, from where it is
    assert 4.0 < tuned.value("balance.dcm_gain") < 5.0
    tuned.finish()
    assert tuned.value("balance.dcm_gain") == law.gains[0] == 5.0


def test_every_gain_reaches_the_law(g1: RobotModel) -> None:
    """Each name moves what it names, and nothing else."""
    law = BalanceController(g1)
    tuned, tasks = Tuning(law), law.whole_body.tasks

    def gains() -> np.ndarray:
        rows = [getattr(task, field) for task in tasks.values() for field in ("kp", "kd", "weight")
                if hasattr(task, field)]  # fmt: skip
        return np.concatenate([law.gains, *rows])

    changed = np.zeros(gains().shape, dtype=bool)
    for name in TUNABLE:
        before = gains()
        tuned.set(name, 1.5 * tuned.value(name))
        tuned.finish()
        moved = gains() != before
        assert moved.any(), name
        assert not (moved & changed).any(), name
        np.testing.assert_allclose(gains()[moved], 1.5 * before[moved])
        changed |= moved


@pytest.mark.parametrize("value", [0.0, 2.4, 10.1, float("nan"), float("inf")])
def test_gains_out_of_range_are_refused(g1: RobotModel, value: float) -> None:
    tuned = Tuning(BalanceController(g1))
    with pytest.raises(CommandError, match=r"balance.dcm_gain: .* is outside \[2.5, 10\]"):
        tuned.set("balance.dcm_gain", value)
    with pytest.raises(CommandError, match="unknown gain 'magic'"):
        tuned.set("magic", 1.0)
    assert not tuned.moving


def test_all_gains_at_once_make_no_step_in_the_torques(g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    tuned = Tuned(g1, noise=False)
    steps = TorqueSteps(tuned.loop)
    tuned.loop.apply_push((30.0, 10.0, 0.0), duration=10.0, body="base_link")  # a load: gains without errors do nothing
    tuned.run(1.0)
    with steps.watch():
        for factor in (2.0, 0.5, 1.0):
            tuned.change_all(factor)
            tuned.run(0.8)
    assert steps.largest < 0.06  # of what the drives can step by
    with monkeypatch.context() as patch:
        patch.setattr(tuning, "RAMP_TIME", 1e-6)
        steps.forget()
        tuned.change_all(2.0)
        with steps.watch():
            tuned.run(0.1)
    assert steps.largest > 0.06
    assert not tuned.loop.fallen


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_it_stands_and_takes_a_push_at_the_ends_of_the_ranges(robot: RobotModel, factor: float) -> None:
    """Each gain alone, then all together; 0.18 m/s at the pelvis."""
    tuned = Tuned(robot, noise=True)
    for names in (*((name,) for name in TUNABLE), TUNABLE):
        for name in names:
            tuned.tuning.set(name, factor * tuned.tuning.value(name))
        tuned.run(0.6)
        tuned.loop.apply_push((1.8 * robot.mass, 0.0, 0.0), duration=0.1, body="base_link")
        tuned.run(1.0)
        assert not tuned.loop.fallen, names
        assert np.abs(tuned.loop.truth.v[:2]).max() < 0.05, names
        tuned.change_all(1.0)
        tuned.run(0.6)
