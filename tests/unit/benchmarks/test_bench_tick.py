"""The tick benchmark: placo solves our problem, timing changes nothing, and every limit is one of a figure."""

import gc
import time
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue, settings
from benchmarks.core.timed_run import STATUSES, Stopwatch
from benchmarks.speed.tick import (
    STAGES,
    SUBJECTS,
    StageProbe,
    TickConfig,
    TimedController,
    beside_kinematics,
    summarise,
)
from benchmarks.speed.tick_peers import PlacoTick, installed_peers
from controllers.balance.controller import BalanceController
from controllers.whole_body.config import WholeBodyConfig
from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import RobotState, SolveStatus
from tests.support import standing

CONFIG = settings(TickConfig, "tick")


@pytest.fixture(scope="module", params=["g1", "talos"])
def model(request: pytest.FixtureRequest) -> RobotModel:
    return RobotModel.load(request.param)


def states(model: RobotModel, count: int) -> list[RobotState]:
    """Near standing, both feet loaded, moving a little."""
    rng = np.random.default_rng(0)
    still = model.standing_configuration()
    found = []
    for k in range(count):
        q = still.copy()
        q[7:] += 0.003 * rng.normal(size=model.nj)
        found.append(standing(model, 0.001 * k, q=q, v=0.02 * rng.normal(size=model.nv)))
    return found


def test_placo_solves_the_same_problem(model: RobotModel) -> None:
    """With one CoM weight for all axes, as placo has it, both find the same accelerations and the same total force."""
    config = default_config(WholeBodyConfig, "controllers", "whole_body")
    config = replace(config, com=replace(config.com, weight_height=config.com.weight))
    controller, placo = BalanceController(model, whole_body=config), PlacoTick(model, config)
    first, *rest = states(model, 4)
    controller.reset(first)
    controller.step(first, 0.001)
    for state in rest:
        result = controller.step(state, 0.001)
        placo.prepare(state, controller)
        placo.step()
        assert placo.success
        np.testing.assert_allclose(placo.acceleration, result.acceleration, atol=5e-3)
        assert np.abs(result.acceleration).max() > 0.5
        terms = controller.whole_body.terms
        load = terms.mass_matrix[:3] @ placo.acceleration + terms.bias[:3]  # total contact force, in the base frame
        ours = sum(terms.soles[k].jacobian[:, :3].T @ result.wrenches[k] for k in range(2))
        np.testing.assert_allclose(load, ours, atol=1e-3 * model.mass * GRAVITY)


def timed_controller(model: RobotModel, ticks: int) -> TimedController:
    controller = BalanceController(model)
    return TimedController(controller, ticks=ticks, stage_period=3, active_tolerance=CONFIG.active_tolerance)


def test_timing_changes_nothing() -> None:
    model = RobotModel.load("g1")
    plain, timed = BalanceController(model), timed_controller(model, 8)
    sequence = states(model, 8)
    plain.reset(sequence[0])
    timed.controller.reset(sequence[0])
    for state in sequence:
        timing = timed.recording() if state is not sequence[0] else nullcontext()
        with timing:
            expected, result = plain.step(state, 0.001), timed.controller.step(state, 0.001)
        np.testing.assert_array_equal(result.command.tau, expected.command.tau)
        np.testing.assert_array_equal(result.command.q, expected.command.q)
    assert timed.count == 7  # the first tick has no reference that placo could get
    assert timed.placo_failed == 0
    assert (timed.wall[:7] > 0).all()
    split = timed.stages[:7].any(axis=1)
    assert split.sum() == 2
    np.testing.assert_array_equal(timed.stages[:7][split].sum(axis=1), timed.wall[:7][split, 0])
    assert (timed.stages[:7][split] > 0).all()
    timed.preempted[:] = False  # on a busy machine every tick may be interrupted
    figures = summarise(timed)
    assert figures["ticks"] == figures["ticks_optimal"] == 7.0 and figures["ticks_uncertified"] == 0.0


@pytest.mark.parametrize("name", ["pink", "mink"])
def test_inverse_kinematics_of_others_solve_for_the_state_they_get(name: str, model: RobotModel) -> None:
    pytest.importorskip(name)
    peer: Any = installed_peers(model)[name]
    peer.prepare(standing(model, 0.0))
    peer.step()
    assert np.abs(peer.velocity).max() < 1e-6  # where it is drawn to
    peer.prepare(states(model, 2)[1])
    peer.step()
    assert np.isfinite(peer.velocity).all() and np.abs(peer.velocity).max() > 0.1


def test_peers_that_are_not_installed_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.speed.tick_peers.find_spec", lambda name: None)
    model = RobotModel.load("g1")
    assert installed_peers(model) == {}
    assert beside_kinematics(model, 0, CONFIG) == {}


@pytest.mark.slow
def test_the_collector_is_off_beside_the_inverse_kinematics_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    collecting = []
    peer = SimpleNamespace(prepare=lambda state: None, step=lambda: collecting.append(gc.isenabled()))
    monkeypatch.setattr("benchmarks.speed.tick.installed_peers", lambda model: {"fake": peer})
    figures = beside_kinematics(RobotModel.load("g1"), 0, replace(CONFIG, kinematics_duration=1.0))
    assert figures["ratio_to_fake"] > 1.0 and not any(collecting[-1000:])


def test_the_probe_leaves_the_controller_as_it_was() -> None:
    whole_body = BalanceController(RobotModel.load("g1")).whole_body
    before = [whole_body.terms.update, whole_body.builder.build, whole_body.solver.solve, whole_body.builder.recover]
    with StageProbe(whole_body).attached():
        assert whole_body.solver.solve != before[2]
    after = [whole_body.terms.update, whole_body.builder.build, whole_body.solver.solve, whole_body.builder.recover]
    assert after == before


def test_figures_leave_out_preempted_and_split_ticks() -> None:
    timed = timed_controller(RobotModel.load("g1"), 6)
    timed.count = 6
    timed.wall[:] = [[100_000, 200_000, 10_000, 50_000]] * 6
    timed.wall[1, 0], timed.preempted[1, 0] = 9_000_000, True
    timed.wall[2, 0], timed.stages[2] = 110_000, 18_000
    timed.wall[3, 1], timed.preempted[3, 1] = 9_000_000, True
    timed.changed[4] = True
    of_six = [SolveStatus.OPTIMAL] * 3 + [SolveStatus.FALLBACK_SOLVER, SolveStatus.RELAXED, SolveStatus.HELD]
    timed.status[:6] = [STATUSES.index(status) for status in of_six]
    timed.cpu[:] = timed.wall
    figures = summarise(timed)
    assert figures["tick_us_max"] == pytest.approx(100.0)
    assert figures["tick_ungated_us_max"] == pytest.approx(9000.0)
    assert figures["preempted_fraction"] == pytest.approx(1 / 5)
    assert figures["ratio_to_placo"] == pytest.approx(0.5)
    assert figures["placo_us_p99"] == pytest.approx(200.0)
    assert [figures[f"ratio_to_{name}"] for name in SUBJECTS[2:]] == [pytest.approx(10.0), pytest.approx(2.0)]
    assert [figures[f"{stage}_us_p50"] for stage in STAGES] == [pytest.approx(18.0)] * len(STAGES)
    assert figures["active_set_changes"] == 1.0
    assert figures["ticks_uncertified"] == 2.0
    bounded = catalogue()["tick"].info.most
    assert len(bounded) == 9 and bounded["ticks_uncertified"] == 0.0
    stack = {"stack_stand_us_p99", "stack_walk_us_p99"}
    assert bounded.keys() - figures.keys() == {"allocated_blocks_growth", "resident_growth_kib", *stack}  # ``measure``
    assert bounded["ratio_to_placo"] < 1.0 < bounded["ratio_to_pinocchio_calls"]


def test_a_tick_of_the_stack_is_its_step_and_the_supervision_after_it() -> None:
    class Stack:
        def step(self, sensors: float, dt: float) -> float:
            return sensors * dt

        def supervise(self, t: float, *, drivers_damped: bool = False) -> float:
            time.sleep(0.002)
            return t

    stack: Any = Stack()
    watch = Stopwatch(4, 2)
    with watch.timing(stack, "step", 0), watch.timing(stack, "supervise", 1):
        assert (stack.step(2.0, 3.0), stack.supervise(1.0, drivers_damped=True), stack.step(1.0, 1.0)) == (
            6.0,
            1.0,
            1.0,
        )
    stack.supervise(1.0)  # not recorded
    wall = watch.wall.sum(axis=1)
    assert watch.count == 2
    assert wall[0] > 2_000_000 > wall[1] > 0 == wall[2]
    assert set(watch.times(0, 1)) <= {*(wall[:2] * 1e-3)}
