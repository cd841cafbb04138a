"""Sensor stamp to command received by the plant over real ROS 2, beside the ping-pong floor of the same run.

Floor, graph, floor: each in real time at 1 kHz. The bridge notes on the monotonic clock when it is about to publish the
sensors of a tick and when the command that carries their stamp arrives. Missed is a tick that no command ever answered,
and a tick that the bridge had to skip because it was late. A command that answers after more than a tick is not missed:
it takes effect one step later, and its share is ``over_a_tick_fraction``.

Bounds: p50 < 1.5 floor p50 + tick, p99 < 2.5 floor p99 + tick, missed < 0.1 %.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Case, LoadMeter, Options, Report
from benchmarks.nodes import pingpong
from bridge.launch import Graph
from bridge.ros.environment import free_domain
from bridge.ros.latency_probe import LatencyProbe
from models.types import Vector

DURATION = 20.0
"""How long the standing robot is measured, for each seed [s]."""

FLOOR_DURATION = 5.0
"""Length of the ping-pong before and after each [s]."""

WARM_UP = 1.0
"""Left out at the beginning of each measurement [s]."""

P50_BOUND, P99_BOUND, MISSED_BOUND = 1.5, 2.5, 0.001
"""What must hold; see the module's text."""

MICRO = 1e-3
"""Nanoseconds to microseconds."""


def latencies(probe: LatencyProbe | dict[str, NDArray[Any]], skip: int) -> tuple[Vector, Vector, float]:
    """Judge the rows of a probe.

    Args:
        probe: Rows, or the same loaded from a file.
        skip: Ticks to leave out at the beginning.

    Returns:
        Latency of every answered tick [us], lateness of every tick [us], and the missed fraction.
    """
    rows = probe if isinstance(probe, dict) else probe.rows()
    active = np.flatnonzero(rows["active"])[skip:]
    active = active[:-1]  # the last tick's answer may have come after the end
    published, received = rows["published"][active], rows["received"][active]
    answered = received > 0
    skipped = int(rows["skipped"][active].sum())
    missed = (np.count_nonzero(~answered) + skipped) / max(len(active) + skipped, 1)
    return (received - published)[answered] * MICRO, rows["late"][active] * 1e6, float(missed)


def run(options: Options) -> Report:
    """Measure; see the module's text."""
    load = LoadMeter()
    cases: list[Case] = [_measure(options.robot, seed) for seed in range(options.seeds)]
    pooled = {name: np.concatenate([case[name] for case in cases]) for name in ("latency", "floor", "late")}
    figures = _figures(pooled)
    figures["missed_fraction"] = float(np.mean([case["missed_fraction"] for case in cases]))
    figures["floor_missed_fraction"] = float(np.mean([case["floor_missed_fraction"] for case in cases]))
    tick = figures["tick_us"] = pingpong.PERIOD * 1e6
    figures["over_a_tick_fraction"] = float(np.mean(pooled["latency"] > tick))
    figures["p50_bound_us"] = P50_BOUND * figures["floor_p50_us"] + tick
    figures["p99_bound_us"] = P99_BOUND * figures["floor_p99_us"] + tick
    bounds = (
        ("p50_us", figures["p50_bound_us"]),
        ("p99_us", figures["p99_bound_us"]),
        ("missed_fraction", MISSED_BOUND),
    )
    held = [figures[name] < bound for name, bound in bounds]
    notes = [
        f"{'holds' if good else 'FAILS'}: {name} {figures[name]:.4g} < {bound:.4g}"
        for (name, bound), good in zip(bounds, held, strict=True)
    ]
    return Report("latency", options.robot, options.seeds, figures, cases, all(held), load.read(), notes)


def _measure(robot: str, seed: int) -> Case:
    domain = free_domain()
    skip = round(WARM_UP / pingpong.PERIOD)
    before = pingpong.measure(robot, FLOOR_DURATION + WARM_UP, domain)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "latency.npz"
        parameters = {"mujoco_bridge": {"latency_file": str(file), "seed": seed}}
        log = Path(folder) / "log"
        with Graph(robot, domain_id=domain, parameters=parameters, log=log, say=lambda _: None) as graph:
            graph.wait_standing()
            graph.spin(DURATION + WARM_UP)
        with np.load(file) as data:
            rows = dict(data)
    after = pingpong.measure(robot, FLOOR_DURATION + WARM_UP, domain)
    latency, late, missed = latencies(rows, skip)
    floors = [latencies(probe, skip) for probe in (before, after)]
    return {
        "seed": seed,
        "load": os.getloadavg()[0],
        "latency": latency,
        "late": late,
        "floor": np.concatenate([floor[0] for floor in floors]),
        "missed_fraction": missed,
        "floor_missed_fraction": float(np.mean([floor[2] for floor in floors])),
    }


def _figures(pooled: dict[str, Vector]) -> dict[str, float]:
    """Percentiles by the names that others rely on."""
    figures = {}
    for name, prefix in (("latency", ""), ("floor", "floor_"), ("late", "late_")):
        for label, percent in (("p50", 50.0), ("p99", 99.0), ("p999", 99.9), ("max", 100.0)):
            figures[f"{prefix}{label}_us"] = float(np.percentile(pooled[name], percent))
    return figures


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw the distributions of latency and floor."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 4.5))
    for name, label in (("floor", "ping-pong floor"), ("latency", "sensor to command")):
        values = np.sort(np.concatenate([np.asarray(case[name]) for case in report.cases]))
        axes.plot(values, 1.0 - np.arange(len(values)) / len(values), label=label)
    axes.set(xscale="log", yscale="log", xlabel="time [us]", ylabel="share of ticks that took longer", ylim=(1e-4, 1))
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    file = folder / "latency.png"
    figure.savefig(file, dpi=120, bbox_inches="tight")
    pyplot.close(figure)
    return [file]
