"""The loop benchmark: splitting changes nothing and adds up, the bare physics are those of the run, bounds bind."""

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Report
from benchmarks.core.loops import demand
from benchmarks.core.timed_run import QUANTILES
from benchmarks.speed import loop as bench
from benchmarks.speed.loop import (
    PLANNER,
    SCENARIOS,
    STAGES,
    SUPERVISE,
    Pieces,
    Span,
    SplitLoop,
    one_core,
    stage_figure,
    summarise,
    time_pieces,
)
from bridge.closed_loop import ClosedLoop
from bridge.loop.lockstep import PlantMonitor
from bridge.plants.world import BarePhysics
from controllers.safety.supervisor import Supervisor

BENCH = catalogue()["loop"].load()
TICKS = 40
PLAIN_UPDATES = PlantMonitor.update, Supervisor.update


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return ClosedLoop("g1", record=False)


@pytest.fixture
def walking(loop: ClosedLoop) -> Iterator[ClosedLoop]:
    loop.reset(0)
    demand(loop, "walk")
    loop.set_velocity(0.3, 0.0, 0.0)
    return loop


def test_splitting_changes_nothing_adds_up_and_comes_off_again(walking: ClosedLoop) -> None:
    for _ in range(TICKS):
        walking.step()
    expected = walking.data.qpos.copy()
    walking.reset(0)
    demand(walking, "walk")
    walking.set_velocity(0.3, 0.0, 0.0)
    split = SplitLoop(walking, TICKS)
    with split.recording():
        for _ in range(TICKS):
            split.step()
    np.testing.assert_array_equal(walking.data.qpos, expected)
    assert split.count == TICKS
    np.testing.assert_array_equal(split.stages.sum(axis=1), split.watch.wall[:, 0])
    always = [k for k in range(len(STAGES)) if k != SUPERVISE]
    assert (split.stages[:, always] > 0).all()
    assert np.count_nonzero(split.stages[:, SUPERVISE]) == TICKS // 10
    assert (PlantMonitor.update, Supervisor.update) == PLAIN_UPDATES
    owners = (walking.plant, walking.estimator, walking.gait, walking.controller, walking.drivers)
    assert not any({"step", "read", "write", "command"} & vars(owner).keys() for owner in owners)


def test_a_standing_robot_plans_too(loop: ClosedLoop) -> None:
    loop.reset(0)
    split = SplitLoop(loop, 20)
    with split.recording():
        for _ in range(20):
            split.step()
    assert split.stages[:, PLANNER].all()


def test_the_bare_physics_go_through_the_states_of_the_run(walking: ClosedLoop) -> None:
    walking.step()  # MuJoCo's contacts are from before the release
    bare = BarePhysics(walking.model, TICKS)
    for _ in range(2):  # a second stretch begins anew
        bare.begin(walking.data)
        for _ in range(TICKS):
            walking.step()
            bare.note(walking.data)
        bare.rewind()
        bare.replay()
        np.testing.assert_array_equal(bare.data.qpos, walking.data.qpos)
        np.testing.assert_array_equal(bare.data.qvel, walking.data.qvel)


def test_all_threads_are_held_to_one_core_and_let_go() -> None:
    before, done = os.sched_getaffinity(0), threading.Event()
    other = threading.Thread(target=done.wait)
    other.start()
    try:
        assert other.native_id is not None
        with pytest.raises(ZeroDivisionError), one_core():
            assert len(os.sched_getaffinity(0)) == 1
            assert os.sched_getaffinity(other.native_id) == os.sched_getaffinity(0) <= before
            raise ZeroDivisionError
        assert os.sched_getaffinity(other.native_id) == os.sched_getaffinity(0) == before
    finally:
        done.set()
        other.join()


def pieces(*cpu: int, others: int = 0) -> Pieces:
    """Plain seconds that took so much processor time [ms], twice that by the clock; four ticks, one interrupted."""
    stages = np.tile(np.arange(1.0, 9.0), (4, 1))
    stages[3] = 1000.0
    return Pieces(
        plain=[Span(2_000_000 * ms, 1_000_000 * (ms + others), 1_000_000 * ms) for ms in cpu],
        split=[Span(1, 1_100_000 * ms, 1) for ms in cpu],
        bare=[Span(1, 50_000_000, 1) for _ in cpu],
        ticks=stages.sum(axis=1),
        kept=np.array([True, True, True, False]),
        stages=stages,
    )


def test_figures_are_of_the_plain_seconds_and_stages_add_up_to_the_tick() -> None:
    figures = summarise({"stand": pieces(200, 250, 900), "walk": pieces(400, 500, 500)})
    assert figures["real_time_stand"] == pytest.approx(2.0)
    assert figures["real_time_stand_cpu"] == pytest.approx(4.0)
    assert figures["core_share_walk"] == pytest.approx(0.5)
    assert figures["cpu_per_wall_walk"] == pytest.approx(0.5)
    assert figures["ratio_to_physics_walk"] == pytest.approx(10.0)
    assert figures["split_over_plain_stand"] == pytest.approx(1.1)
    assert figures["tick_walk_us_max"] == figures["tick_walk_us_mean"] == pytest.approx(36.0)
    assert sum(figures[stage_figure(stage, "walk")] for stage in STAGES) == pytest.approx(36.0)
    assert figures["tick_walk_ungated_us_p99"] > 5000.0
    assert (figures["other_threads_share"], figures["preempted_fraction"]) == (0.0, 0.25)


def test_work_of_other_threads_counts_as_the_loops() -> None:
    figures = summarise({name: pieces(100, others=100) for name in SCENARIOS})
    assert figures["real_time_walk_cpu"] == pytest.approx(5.0)
    assert figures["other_threads_share"] == pytest.approx(0.5)


@pytest.mark.parametrize(("stand", "walk", "others", "passed"), [
    (330, 330, 0, True), (340, 330, 0, False), (330, 340, 0, False), (100, 100, 3, False),
])  # fmt: skip
def test_slower_than_the_goal_fails(stand: int, walk: int, others: int, passed: bool) -> None:
    figures = summarise({"stand": pieces(stand, others=others), "walk": pieces(walk, others=others)})
    report = Report("loop", "g1", 1, figures, [{"seed": 0, "figures": figures}], True, {})
    assert BENCH.bounds(report)["real_time_walk_cpu"].least == 3.0
    assert BENCH.passed(report) is passed


def test_a_report_of_a_short_run(loop: ClosedLoop, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def measured(robot: str, seed: int) -> dict[str, object]:
        loop.reset(seed)
        found = {name: time_pieces(loop, loop, 2, 0.02) for name in SCENARIOS}
        for pieces in found.values():
            pieces.kept[:] = True  # on a busy machine every tick may be interrupted
        quantiles = {f"tick_{name}": np.percentile(found[name].ticks, QUANTILES).tolist() for name in SCENARIOS}
        return {"figures": summarise(found, 0.02), "quantiles": quantiles}

    monkeypatch.setattr(bench.Loop, "measure", staticmethod(measured))
    report: Report = BENCH.run(Options("g1"))
    figures = report.figures
    for name in SCENARIOS:
        whole = sum(figures[stage_figure(stage, name)] for stage in STAGES)
        assert whole == pytest.approx(figures[f"tick_{name}_us_mean"])
        assert 0.0 < figures[f"physics_{name}_us_mean"] < whole
        assert figures[f"ratio_to_physics_{name}"] > 1.0 and figures[f"bare_physics_{name}_us"] > 0.0
        assert figures[f"real_time_{name}_cpu"] == pytest.approx(1.0 / figures[f"core_share_{name}"])
    assert BENCH.bounds(report).keys() <= figures.keys()
    assert "by the clock" in report.notes[-1]
    (file,) = BENCH.plots(report, tmp_path)
    assert file.stat().st_size > 5_000
