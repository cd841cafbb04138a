"""Pictures of the report hold what was measured, and none is drawn of nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks import report_plots, report_survival
from benchmarks.harness import Case, Report
from benchmarks.report_page import PICTURES
from benchmarks.spread import spread
from benchmarks.timed_run import QUANTILES

LOAD = {"before": [0.0] * 3, "after": [0.0] * 3, "cores": 2}


def reports(**cases: list[Case]) -> dict[tuple[str, str], Report]:
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
    figure = report_plots.draw_times(reports(tick=[{"quantiles": {"tick": values}}]))
    assert figure is not None
    stairs = figure.axes[0].patches[0].get_data()  # type: ignore[attr-defined]
    assert stairs.values.sum() == pytest.approx(1.0)
    assert (stairs.edges[0], stairs.edges[-1]) == pytest.approx((80.0, 400.0))


@pytest.mark.parametrize("kept", [True, False])
def test_latencies_are_drawn_from_what_a_case_keeps_and_from_samples_of_reports_before(kept: bool) -> None:
    samples = {"latency": np.geomspace(400.0, 1600.0, 5000), "floor": np.geomspace(200.0, 300.0, 5000)}
    case = {"spreads": {name: spread(values) for name, values in samples.items()}}
    figure = report_plots.draw_times(reports(latency=[case if kept else samples, {"failure": "did not stand"}]))
    assert figure is not None
    drawn = [patch.get_data() for patch in figure.axes[0].patches]  # type: ignore[attr-defined]
    assert [stairs.values.sum() for stairs in drawn] == pytest.approx([1.0, 1.0])
    assert [stairs.edges[0] for stairs in drawn] == pytest.approx([400.0, 200.0])
    assert drawn[0].values == pytest.approx(np.full(59, 1.0 / 59.0), rel=0.2)  # evenly spread over the logarithm


def test_the_terrain_map_says_how_many_survived() -> None:
    cases = [{"scenario": "tiles", "survived": k > 1, "fell": k < 2, "time": 5.0 + k} for k in range(20)]
    found = reports(terrain=cases)
    figure = report_survival.draw_terrain(found)
    assert figure is not None and [text.get_text() for text in figure.axes[0].texts] == ["18/20"]
    assert figure.axes[0].images[0].get_array().tolist() == [[0.9]]  # type: ignore[union-attr]
    curves = report_survival.draw_curves(found)
    assert curves is not None and len(curves.axes) == 1
    assert curves.axes[0].lines[0].get_ydata()[-1] == pytest.approx(0.9)  # type: ignore[index]


def test_the_delay_margin_stands_beside_its_bound() -> None:
    rows = [{"row": name, "margin": margin, "group": "joints", "ok": True} for name, margin in (
        ("delay_margin", 0.03), ("delay_margin_walk", 0.0125))]  # fmt: skip
    figure = report_plots.draw_delays(reports(faults=rows))
    assert [y for _, y in points(figure)] == pytest.approx([30.0, 12.5])
    assert report_plots.draw_delays(reports(faults=[{"row": "knee_dead", "group": "motors", "ok": True}])) is None
