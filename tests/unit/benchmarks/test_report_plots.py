"""Pictures of the report hold what was measured, and none is drawn of nothing."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.core import benchmark
from benchmarks.core.benchmark import bounds_of, catalogue
from benchmarks.core.harness import Case, Report
from benchmarks.core.results import read_lines
from benchmarks.core.timed_run import QUANTILES, spread
from benchmarks.report import report_plots, report_survival
from benchmarks.report.report_page import PICTURES, bounded, limited
from benchmarks.report.report_survival import draw_push_maps, wilson
from benchmarks.stability.push_map import map_config

LOAD = {"before": [0.0] * 3, "after": [0.0] * 3, "cores": 2}


def reports(**cases: list[Case]) -> dict[tuple[str, str], Report]:
    """Of one robot, by bench."""
    return {(bench, "g1"): Report(bench, "g1", 1, {}, found, True, LOAD) for bench, found in cases.items()}


def points(figure: Figure | None, panel: int = 0) -> list[tuple[float, float]]:
    assert figure is not None
    lines = [line for line in figure.axes[panel].lines if line.get_marker() in ("o", "x")]
    return [(float(x), float(y)) for line in lines for x, y in zip(*line.get_data(), strict=True)]


@pytest.mark.parametrize("draw", [draw for _, _, draw in PICTURES])
def test_nothing_is_drawn_of_nothing(draw: Callable[[Any], Figure | None]) -> None:
    assert draw({}) is None


def walk(scenario: str, velocity: list[float], cost: float, *, fell: bool = False) -> Case:
    command = {"forward": [0.6, 0.0, 0.0], "turn": [0.0, 0.0, 0.6]}[scenario]
    given = {"kind": "steady", "scenario": scenario, "command": command, "velocity": velocity, "fell": fell}
    return {**given, "cost_of_transport": cost}


WALKS = reports(
    walk=[
        walk("forward", [0.58, 0.01, 0.0], 0.7),
        walk("forward", [0.2, 0.0, 0.0], 0.9, fell=True),
        walk("turn", [0.0, 0.0, 0.61], float("nan")),
        {"kind": "stop", "scenario": "stop", "fell": False},
    ]
)


def test_speeds_are_drawn_against_their_commands() -> None:
    assert sorted(points(report_plots.draw_speeds(WALKS))) == [(0.0, 0.0), (0.6, 0.2), (0.6, 0.58)]
    assert (0.6, 0.61) in points(report_plots.draw_speeds(WALKS), 2)


def test_the_cost_of_turning_in_place_is_none() -> None:
    assert [y for _, y in points(report_plots.draw_cost(WALKS))] == [0.7, 0.9]


def test_a_histogram_from_quantiles_holds_every_sample() -> None:
    values = np.geomspace(80.0, 400.0, len(QUANTILES)).tolist()
    slower = (2.0 * np.array(values)).tolist()
    found = reports(tick=[{"quantiles": {"tick": slower, "pinocchio_calls": values}}])
    found["tick", "g1"].figures["tick_us_p50"] = 123.0
    figure = report_plots.draw_times(found)
    assert figure is not None
    tick, calls = [patch.get_data() for patch in figure.axes[0].patches]  # type: ignore[attr-defined]
    np.testing.assert_array_equal(tick.edges, calls.edges)  # the areas can be compared
    assert tick.edges[0] == 80.0 and tick.edges[-1] == slower[QUANTILES.index(report_plots.SHOWN)]
    assert tick.values.sum() == pytest.approx(report_plots.SHOWN) and calls.values.sum() == pytest.approx(100.0)
    label = figure.axes[0].get_legend_handles_labels()[1][0]
    assert "p50 123" in label and "largest 800 us" in label


def test_latencies_are_drawn_from_what_a_case_keeps() -> None:
    samples = {"latency": np.geomspace(400.0, 1600.0, 5000), "floor": np.geomspace(200.0, 300.0, 5000)}
    case = {"scenario": "idle", "spreads": {name: spread(values) for name, values in samples.items()}}
    failed = {"scenario": "idle", "failure": "did not stand"}
    figure = report_plots.draw_times(reports(latency=[case, failed]))
    assert figure is not None
    way, floor = [patch.get_data() for patch in figure.axes[0].patches]  # type: ignore[attr-defined]
    assert [way.values.sum(), floor.values.sum()] == pytest.approx([report_plots.SHOWN, 100.0])
    assert way.edges[0] == 200.0 and way.edges[-1] == pytest.approx(
        np.percentile(samples["latency"], report_plots.SHOWN)
    )
    assert not way.values[way.edges[1:] < 400.0].any() and not floor.values[floor.edges[:-1] > 300.0].any()


def test_the_terrain_map_says_how_many_survived() -> None:
    cases = [{"scenario": "tiles", "survived": k > 1, "fell": k < 2, "time": 5.0 + k} for k in range(20)]
    found = reports(terrain=cases)
    figure = report_survival.draw_terrain(found)
    assert figure is not None and [text.get_text() for text in figure.axes[0].texts] == ["18/20\n0.70 to 0.97"]
    assert figure.axes[0].images[0].get_array().tolist() == [[0.9]]  # type: ignore[union-attr]
    curves = report_survival.draw_curves(found)
    assert curves is not None and len(curves.axes) == 1
    assert curves.axes[0].lines[0].get_ydata()[-1] == pytest.approx(0.9)  # type: ignore[index]
    bars = [bar.get_segments()[0] for bar in curves.axes[0].collections]  # type: ignore[attr-defined]
    assert len(bars) == report_survival.BARS
    assert bars[-1][:, 1] == pytest.approx(wilson(18, 20))


def test_the_delay_margin_stands_beside_its_bound() -> None:
    rows = [{"row": name, "margin": margin, "group": "joints", "ok": True} for name, margin in (
        ("delay_margin", 0.03), ("delay_margin_walk", 0.0125))]  # fmt: skip
    figure = report_plots.draw_delays(reports(faults=rows))
    assert [y for _, y in points(figure)] == pytest.approx([30.0, 12.5])
    assert report_plots.draw_delays(reports(faults=[{"row": "knee_dead", "group": "motors", "ok": True}])) is None


def push(angle: float, **values: float) -> Case:
    given = {"angle": angle, "mass": 30.0, "dv": 0.6, "bound_dv": 0.5, "bound": 100.0, "torque_bound": 80.0}
    return given | {"ankle_dv": 0.5, "steps_dv": 1.2} | values


def test_push_maps_of_standing_and_walking_have_their_bounds() -> None:
    directions = [0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi]
    found = reports(push_walk=[push(angle) for angle in directions], push=[push(angle) for angle in directions])
    figure = draw_push_maps(found)
    assert figure is not None and len(figure.axes) == 2
    for axes, doing, words in zip(
        figure.axes,
        ("no step", "walking at"),
        (("ankle bound", "required"), ("step capturability", "ankle bound", "required", "goal")),
        strict=True,
    ):
        labels = " ".join(axes.get_legend_handles_labels()[1])
        assert doing in axes.get_title() and all(word in labels for word in words)


def test_a_push_is_held_against_the_nearest_direction_of_each_limit() -> None:
    cases = [push(0.0), push(0.5 * np.pi, dv=0.4, bound_dv=0.5)]
    rows = {row.limit: row for row in limited(reports(push=cases))}
    assert rows["ankle bound"].ratio == pytest.approx(0.8) and "left" in rows["ankle bound"].what
    assert rows["torque-limited bound"].value == pytest.approx(0.4)
    assert rows["torque-limited bound"].ratio == pytest.approx(1.0)
    beyond = reports(push_walk=[push(0.0, ankle_dv=0.0, steps_dv=1.2)])  # the DCM was beyond the edge already
    assert {row.limit: row.ratio for row in limited(beyond)} == {"N-step capturability": pytest.approx(0.5)}
    fell = reports(push_walk=[push(0.0), push(1.0, dv=0.0, ankle_dv=0.0, steps_dv=0.0)])  # before the push
    assert [row.ratio for row in limited(fell)] == [0.0, 0.0]


def test_times_are_held_against_their_floors() -> None:
    found = reports(tick=[], latency=[])
    found["tick", "g1"].figures.update(tick_us_p50=80.0, pinocchio_calls_us_p50=32.0)
    found["latency", "g1"].figures.update(p50_us=600.0, floor_p50_us=200.0)
    assert [row.ratio for row in limited(found)] == [2.5, 3.0]


def test_a_figure_that_breaks_its_bound_is_shown_so() -> None:
    (report,) = reports(push_walk=[]).values()
    report.figures.update(dv_min=map_config().required["walk"].smallest - 0.1, dv_median=2.0, legs_touched=1.0)
    assert bounded(report, "dv_min") == "**0.4** (not ≥ 0.5)"
    assert bounded(report, "dv_median") == "2 (≥ 0.8)"
    assert bounded(report, "legs_touched") == "1" and bounded(report, "absent") == bounded(None, "dv_min") == "-"


def test_a_figure_with_a_bound_of_zero_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    monkeypatch.setattr(benchmark, "saved", lambda figure, file: figures.append(figure) or file)
    found = {"ticks_uncertified": 3.0, "gait_us_p99": 2500.0}
    catalogue()["gait"].load().plots(Report("gait", "g1", 1, found, [], True, LOAD), tmp_path)
    (axes,) = figures[0].axes
    assert sorted(bar.get_width() for bar in axes.patches) == [0.5, 4.0]  # type: ignore[attr-defined]


@pytest.mark.parametrize(("bench", "passed"), [("endurance", False), ("push_walk", False), ("sim2sim_sdk", True)])
def test_a_bound_whose_figure_is_not_measured_fails_unless_it_is_of_another_scenario(bench: str, passed: bool) -> None:
    pytest.importorskip("rclpy")
    report = Report(bench, "g1", 1, {}, [], True, LOAD)
    assert catalogue()[bench].load().passed(report) is passed
    assert any("nan" in text for _, text in catalogue()[bench].load().judged(report)) is not passed


def test_every_benchmark_has_bounds_of_figures_that_it_knows() -> None:
    """Each benchmark shows a figure with a bound, and every bound of the published ones is of a measured figure."""
    published = read_lines(Path(__file__).parents[3] / "docs/benchmark_report/reports.jsonl")
    for line in published:
        info = catalogue()[line["bench"]].info
        assert {*info.least, *info.most} <= set(line["figures"]), line["bench"]
    figures = {"stand_total": 1.0, "motions_total": 1.0, "total": 1.0, "p50_bound_us": 1.0, "p99_bound_us": 1.0}
    figures |= {"p50_us": 2.0, "p99_us": 2.0}
    for bench, listed in catalogue().items():
        report = Report(bench, "g1", 1, figures, [{"scenario": "idle"}] if bench == "latency" else [], True, LOAD)
        assert bench == "scaling" or set(bounds_of(report)) & {*listed.info.keys, *listed.info.figures}, bench
