"""Judgement of ``poise bench estimate``: the statistics, and that every bound can fail."""

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Report
from benchmarks.core.timed_run import Stopwatch
from benchmarks.stability.estimate import PARTS, drift, estimate_config, interval, mean_nees, nees, scenarios, summarise

RUNS = 20


def case(scenario: str, **changes: object) -> dict[str, object]:
    """One run of a sound estimator."""
    good: dict[str, object] = {
        "scenario": scenario,
        "velocity_rmse": 0.002,
        "tilt_rmse_deg": 0.2,
        "height_rmse": 0.001,
        "distance": 4.0,
        "drift": [0.0, 0.012, 0.016],
        "nees": {name: [float(rows.size)] * 4 for name, rows in PARTS.items()},
        "ok": True,
    }
    return good | changes


def held(figures: dict[str, float], runs: int) -> dict[str, bool]:
    """Whether each bound holds, by figure."""
    bounds = catalogue()["estimate"].load().bounds(Report("estimate", "g1", runs, figures, [], True, {}))
    return {name: bound.holds(figures[name]) for name, bound in bounds.items()}


def judged(changed: str = "", **changes: object) -> dict[str, bool]:
    """Verdicts on runs of every scenario, one of them changed."""
    results = [case(name, **(changes if name == changed else {})) for name in scenarios() for _ in range(RUNS)]
    timing = {"estimator_us_p50": 60.0, "allocated_blocks_growth": 0.0}
    return held(summarise(results, estimate_config()) | timing, RUNS)


def test_sound_runs_pass() -> None:
    assert all(judged().values())


@pytest.mark.parametrize(
    ("scenario", "changes", "bound"),
    [
        ("push", {"velocity_rmse": 0.031}, "velocity_rmse"),
        ("squat", {"tilt_rmse_deg": 0.51}, "tilt_rmse_deg"),
        ("wave", {"height_rmse": 0.0051}, "height_rmse"),
        ("walk", {"velocity_rmse": 0.061}, "velocity_rmse_walk"),
        ("walk", {"drift": [0.0, 0.03, 0.03]}, "drift"),
        ("stand", {"ok": False}, "fallen"),
        ("stand", {"nees": {name: [2.5 * rows.size] * 4 for name, rows in PARTS.items()}}, "nees_velocity"),
        ("walk", {"nees": {name: [2.5 * rows.size] * 4 for name, rows in PARTS.items()}}, "nees_joint"),
        ("stand", {"nees": {name: [0.4 * rows.size] * 4 for name, rows in PARTS.items()}}, "nees_height"),
        ("wave", {"nees": {name: [0.4 * rows.size] * 4 for name, rows in PARTS.items()}}, "nees_joint"),
    ],
)
def test_every_bound_can_fail(scenario: str, changes: dict[str, object], bound: str) -> None:
    failed = [name for name, held in judged(scenario, **changes).items() if not held]
    assert any(name.startswith(bound) for name in failed)


def test_walking_has_its_own_bounds_on_errors() -> None:
    assert all(judged("walk", velocity_rmse=0.05, height_rmse=0.02).values())


def test_slow_or_growing_steps_fail() -> None:
    figures = summarise([case(name) for name in scenarios()], estimate_config())
    for timing in ((121.0, 0.0), (60.0, 0.02)):
        timed = dict(zip(("estimator_us_p50", "allocated_blocks_growth"), timing, strict=True))
        assert not all(held(figures | timed, 1).values())


def test_nees_of_drawn_errors_lies_in_its_interval() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(12, 12))
    covariance = root @ root.T
    count = 400
    errors = rng.normal(size=(count * RUNS, 12)) @ root.T
    for rows in PARTS.values():
        values = nees(errors, np.broadcast_to(covariance, (count * RUNS, 12, 12)), rows)
        means = values.reshape(count, RUNS).mean(axis=1)
        low, high = interval(rows.size, RUNS, 0.95)
        inside = float(((low < means) & (means < high)).mean())
        assert inside == pytest.approx(0.95, abs=0.04)
        doubled = nees(errors, np.broadcast_to(0.25 * covariance, (count * RUNS, 12, 12)), rows)
        np.testing.assert_allclose(doubled, 4.0 * values)


def test_mean_is_over_runs_at_each_instant_of_the_shortest() -> None:
    runs = [{"nees": {"tilt": [1.0, 2.0, 3.0]}}, {"nees": {"tilt": [3.0, 6.0]}}]
    np.testing.assert_allclose(mean_nees(runs, "tilt"), [2.0, 4.0])


def test_drift_is_the_growth_of_the_error_over_the_distance() -> None:
    assert drift(case("walk")) == pytest.approx(0.02 / 4.0)


def test_stopwatch_times_every_call_and_puts_the_method_back() -> None:
    class Law:
        def step(self, x: float) -> float:
            return 2.0 * x

    law = Law()
    watch = Stopwatch(3, 1)
    with watch.timing(law, "step"):
        assert [law.step(x) for x in (1.0, 2.0, 3.0, 4.0)] == [2.0, 4.0, 6.0, 8.0]
    assert (watch.wall > 0).all() and watch.times(0).size <= 3
    assert "step" not in vars(law)
