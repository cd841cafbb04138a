"""The gait benchmark: timing changes nothing and comes off again, figures count what they should."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Report
from benchmarks.core.loops import advance
from benchmarks.core.timed_run import STATUSES
from benchmarks.speed.gait import (
    ADJUSTMENT,
    GAIT,
    PINOCCHIO,
    PLACO,
    SUBJECTS,
    TICK,
    TimedWalk,
    summarise,
)
from controllers.balance.controller import BalanceController
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import Mode, RobotState, SolveStatus
from planners.gait.adjustment import StepPlanner
from planners.gait.planner import GaitPlanner
from planners.gait.state import GaitPhase
from tests.support import standing

BOUNDS = catalogue()["gait"].info.most
DT = 0.002


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return RobotModel.load("g1")


def state(model: RobotModel, planner: GaitPlanner, t: float) -> RobotState:
    """Standing still; the foot that is to swing bears nothing."""
    if planner.phase is not GaitPhase.SINGLE:
        return standing(model, t)
    return standing(model, t, shares=(0.5, 0.0) if planner.stance == 0 else (0.0, 0.5))


Walk = tuple[GaitPlanner, BalanceController]


def walk(model: RobotModel) -> Walk:
    planner = GaitPlanner(model)
    controller = BalanceController(model)
    controller.set_gait(planner)
    controller.reset(state(model, planner, 0.0))
    controller.enter(Mode.WALK)
    planner.set_velocity(0.3, 0.0, 0.0)
    return planner, controller


def torques(made: Walk, ticks: int, first: int = 0) -> np.ndarray:
    planner, controller = made
    rows = []
    for k in range(first, first + ticks):
        now = state(planner.model, planner, k * DT)
        rows.append(controller.step(now, DT).command.tau)
    return np.array(rows)


def test_timing_changes_nothing_and_comes_off_again(model: RobotModel) -> None:
    ticks, plain_adjust = 360, StepPlanner.adjust
    expected = torques(walk(model), ticks)
    made = walk(model)
    timed = TimedWalk(*made, ticks)
    with timed.recording():
        found = [torques(made, ticks - 20)]
        timed.with_placo = True
        found.append(torques(made, 20, ticks - 20))
    found = np.concatenate(found)
    np.testing.assert_array_equal(found, expected)
    assert timed.count == ticks
    assert made[0].phase is GaitPhase.SINGLE  # so both kinds of support have been seen
    assert 0 < timed.adjusted.sum() < timed.single.sum() < ticks
    wall = timed.watch.wall
    assert (wall[:, [GAIT, TICK, PINOCCHIO]] > 0).all()
    np.testing.assert_array_equal(wall[:, PLACO] > 0, timed.beside)
    assert timed.beside.sum() == 20 and timed.single[timed.beside].any() and timed.placo_failed == 0
    assert 0.0 < timed.residual.max() < BOUNDS["kkt_residual_max"]
    np.testing.assert_array_equal(wall[:, ADJUSTMENT] > 0, timed.adjusted)
    assert (wall[timed.adjusted, ADJUSTMENT] < wall[timed.adjusted, GAIT]).all()  # one is part of the other
    assert StepPlanner.adjust is plain_adjust
    assert not {"step"} & (vars(made[0]).keys() | vars(made[1]).keys())


def recorded(model: RobotModel) -> TimedWalk:
    """Eight ticks; the first is one of double support, the third and fifth adjust the step, the last two have placo."""
    timed = TimedWalk(*walk(model), 8)
    timed.count = 8
    timed.single[1:], timed.adjusted[[2, 4]], timed.beside[6:] = True, True, True
    timed.watch.wall[:] = [200_000, 60_000, 120_000, 0, 40_000]
    timed.watch.wall[~timed.adjusted, ADJUSTMENT] = 0
    timed.watch.wall[6:, [TICK, PLACO]] = 150_000, 300_000
    timed.watch.wall[0, TICK] = 900_000  # in double support: no matter here
    return timed


def test_figures_count_single_support_and_adjustments_only(model: RobotModel) -> None:
    timed = recorded(model)
    timed.status[3], timed.residual[4] = STATUSES.index(SolveStatus.RELAXED), 1e-9
    figures = summarise(timed)
    assert (figures["ticks"], figures["adjustments"], figures["ticks_single_support"]) == (6.0, 2.0, 5.0)
    assert figures["gait_us_p50"] == pytest.approx(200.0)
    assert figures["adjustment_us_p50"] == pytest.approx(60.0)
    assert figures["tick_us_max"] == pytest.approx(120.0)
    assert figures["ratio_to_pinocchio_calls"] == pytest.approx(3.0)
    assert figures["ratio_to_placo"] == pytest.approx(0.5)  # of the ticks beside it
    assert figures["p99_over_median"] == pytest.approx(1.0)
    assert figures["kkt_residual_max"] == 1e-9
    assert (figures["ticks_uncertified"], figures["ticks_relaxed"]) == (1.0, 1.0)


def test_preempted_samples_are_left_out_and_counted(model: RobotModel) -> None:
    timed = recorded(model)
    for row, subject in ((3, GAIT), (4, ADJUSTMENT), (5, TICK)):
        timed.watch.wall[row, subject] = 9_000_000
        timed.watch.preempted[row, subject] = True
    figures = summarise(timed)
    maxima = [figures[f"{name}_us_max"] for name in SUBJECTS]
    assert maxima == pytest.approx([200.0, 60.0, 120.0, 300.0, 40.0])
    assert figures["preempted_fraction"] == pytest.approx(1 / 6)
    assert figures["tick_ungated_us_p99"] > 5000.0


def test_a_walk_without_an_adjustment_has_no_figures(model: RobotModel) -> None:
    timed = recorded(model)
    timed.adjusted[:] = False
    with pytest.raises(ValueError, match="adjustment_us: no samples"):
        summarise(timed)


def test_a_fall_is_no_figure() -> None:
    loop = SimpleNamespace(run=lambda _: None, fallen=True, fall_reason="tilted", robot=SimpleNamespace(name="g1"))
    with pytest.raises(PoiseError, match="g1 fell: tilted"):
        advance(loop, 1.0)


def test_every_limit_is_one_of_a_figure(model: RobotModel) -> None:
    report = Report("gait", "g1", 1, {}, [], True, {})
    bounded = {name: bound.most for name, bound in catalogue()["gait"].load().bounds(report).items()}
    assert len(bounded) == 10
    assert bounded.keys() - summarise(recorded(model)).keys() == {"allocated_blocks_growth", "resident_growth_kib"}
    assert bounded == BOUNDS and bounded["ticks_uncertified"] == 0.0
    assert bounded["ratio_to_placo"] < 1.0 < bounded["ratio_to_pinocchio_calls"]


def test_figures_are_drawn_over_their_bounds(tmp_path: Path) -> None:
    bench, figures = catalogue()["gait"].load(), {"gait_us_p99": 2.0 * BOUNDS["gait_us_p99"], "p99_over_median": 1.0}
    (file,) = bench.plots(Report("gait", "g1", 1, figures, [], False, {}), tmp_path)
    assert file.name == "gait-g1.png" and file.stat().st_size > 5_000
    assert bench.plots(Report("gait", "g1", 1, {}, [], True, {}), tmp_path) == []
