"""Sensor stamp to command received by the plant over real ROS 2, beside the ping-pong floor of the same run.

Floor, graph, floor: each in real time, by default at 1 kHz. The bridge notes on the monotonic clock when it is about to
publish the sensors of a tick and when the command that carries their stamp arrives; the process of the laws notes when
each stage between ends (``benchmarks/latency_stages.py``). Missed is a tick that no command ever answered, and a tick
that the bridge had to skip because it was late. A command that answers after more than a tick is not missed: it takes
effect one step later, and its share is ``over_a_tick_fraction``.

Bounds, of the idle graph: p50 < 1.5 floor p50 + tick, p99 < 2.5 floor p99 + tick, missed < 0.1 %. Other scenarios are
measured when chosen, have their name before their figures, and no bound; the verdict on the machine tells whether they
are within it.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from benchmarks.harness import Case, LoadMeter, Options, Report, chosen, run_cases
from benchmarks.latency_config import latency_config
from benchmarks.latency_stages import STAGES, answered, split, tails
from benchmarks.machine import Machine, advice, read_machine
from benchmarks.nodes import pingpong
from benchmarks.nodes.graph_run import Run, run_graphs
from benchmarks.spread import percentiles_of, spread, spread_of
from benchmarks.timed_run import QUANTILES
from bridge.ros.environment import free_domain
from bridge.ros.latency_probe import LatencyProbe
from bridge.ros.stage_probe import LEFT, RIGHT, cost
from models.constants import NANOSECONDS
from models.errors import PoiseError
from models.types import Vector

TICK = 0.001
"""Of physics and drivers [s]."""

SUPPORTS = {"single": (LEFT, RIGHT), "double": (LEFT | RIGHT,)}
"""Contacts of the ticks that ``<scenario>_single_`` and ``_double_`` figures are of."""


def run(options: Options) -> Report:
    """Measure; see the module's text.

    Args:
        options: Robot, seeds and scenarios.

    Raises:
        ConfigError: A scenario is unknown.
        PoiseError: The ping-pong does not come up.
    """
    config, load, machine = latency_config(), LoadMeter(), read_machine()
    names = chosen("latency", options.scenarios, list(config.scenarios), config.usual)
    cases: list[Case] = []
    figures: dict[str, float] = {}
    notes: list[str] = []
    held, told = {}, {}
    for name in names:
        scenario = config.scenarios[name]
        inputs = [{"robot": options.robot, "seed": seed, "scenario": name} for seed in range(options.seeds)]
        of = run_cases(_measure, inputs, bench="latency", options=options, alone=True)
        found = summarise(of, 1.0 / (scenario.rate * scenario.speed))
        held[name], lines = judge(found)
        told[name if scenario.speed == 1.0 else f"{name} at {scenario.speed:g} of real time"] = held[name]
        prefix = "" if name == "idle" else f"{name}_"
        figures |= {f"{prefix}{key}": value for key, value in found.items()}
        lines += [f"seed {case['seed']}: {case['failure']}" for case in of if "failure" in case]
        notes += [f"{name}: {line}" for line in lines]
        cases += of
    figures["stamps_us"] = cost() * 1e6
    bounded = [name for name in names if name in config.usual]
    notes += verdict(told, machine)
    passed = all(held[name] for name in bounded)
    return Report("latency", options.robot, options.seeds, figures, cases, passed, load.read(), notes)


def _measure(robot: str, seed: int, scenario: str) -> Case:
    """One case; a graph that does not come up, or does not last, is a result: ``failure`` says what happened."""
    config = latency_config()
    given = config.scenarios[scenario]
    period = 1.0 / (given.rate * given.speed)
    length, skip = config.floor_duration + config.warm_up, round(config.warm_up / period)
    domain = free_domain()
    case: Case = {"scenario": scenario, "seed": seed, "load": os.getloadavg()[0]}
    before = pingpong.measure(robot, length, domain, period)
    try:
        runs = run_graphs(robot, seed, given, config)
    except PoiseError as error:
        return case | {"failure": str(error)}
    if (stood := _active_time(runs[0])) < config.duration:
        return case | {"failure": f"the drivers were active for {stood:.1f} s of {config.duration:g} s"}
    after = pingpong.measure(robot, length, domain, period)
    floors = [_latencies(probe, skip) for probe in (before, after)]
    first, *others = (_case(run, skip, period) for run in runs)
    first["spreads"]["floor"] = spread(np.concatenate([floor[0] for floor in floors]))
    return {
        **case,
        **first,
        "floor_missed_fraction": float(np.mean([floor[1] for floor in floors])),
        "others": [{"missed_fraction": other["missed_fraction"], **other["spreads"]["latency"]} for other in others],
    }


def _latencies(probe: LatencyProbe, skip: int) -> tuple[Vector, float]:
    """Latency of every answered tick [us], and the missed fraction."""
    rows = probe.rows()
    ticks, _, missed = answered(rows, skip)
    return (rows["received"][ticks] - rows["published"][ticks]) * 1e-3, missed


def _active_time(run: Run) -> float:
    """Time from the first tick to the last at which the drivers executed commands [s]."""
    times = run.bridge["published"][run.bridge["active"]]
    return float(np.ptp(times)) / NANOSECONDS if len(times) else 0.0


def _case(run: Run, skip: int, tick: float) -> Case:
    """What one graph gave, as a case keeps it.

    Args:
        run: Its rows.
        skip: Ticks to leave out at the beginning.
        tick: Time between two samples of the sensors [s].
    """
    ticks, late, missed = answered(run.bridge, skip)
    latency = (run.bridge["received"][ticks] - run.bridge["published"][ticks]) * 1e-3
    samples = {"latency": latency, "late": late}
    if run.laws:
        whole = split(run.bridge, run.laws, skip, round(TICK * NANOSECONDS))
        samples |= {f"stage_{stage}": whole.stages[:, i] for i, stage in enumerate(STAGES)}
        shares = {name: np.isin(whole.contacts, feet) for name, feet in SUPPORTS.items()}
        if all(share.any() for share in shares.values()):
            for name, share in shares.items():
                samples[name] = whole.total[share]
                samples[f"{name}_stage_qp"] = samples["stage_qp"][share]
    return {
        "missed_fraction": missed,
        "over_a_tick_fraction": float(np.mean(latency > tick * 1e6)) if latency.size else 0.0,
        "cpu": {name: use.cpu for name, use in run.use.items()},
        "memory": {name: use.memory for name, use in run.use.items()},
        "spreads": {name: spread(values) for name, values in samples.items()},
    }


def summarise(cases: list[Case], tick: float) -> dict[str, float]:
    """Figures of the cases of one scenario, by the names that others rely on.

    Args:
        cases: One a seed.
        tick: Time between two samples of the sensors, in real time [s].
    """
    config = latency_config()
    stood = [case for case in cases if "failure" not in case]
    figures = {"stood_fraction": len(stood) / len(cases)}
    if not stood:
        return figures
    for name in dict.fromkeys(name for case in stood for name in case["spreads"]):
        spreads = [case["spreads"][name] for case in stood if name in case["spreads"]]
        figures |= tails(spreads, "" if name == "latency" else f"{name}_")
    for name in ("missed_fraction", "floor_missed_fraction", "over_a_tick_fraction"):
        figures[name] = float(np.mean([case[name] for case in stood]))
    figures["tick_us"] = tick * 1e6
    figures["p50_bound_us"] = config.p50_bound * figures["floor_p50_us"] + figures["tick_us"]
    figures["p99_bound_us"] = config.p99_bound * figures["floor_p99_us"] + figures["tick_us"]
    for part in ("p50", "p99"):
        figures[f"ratio_to_floor_{part}"] = figures[f"{part}_us"] / figures[f"floor_{part}_us"]
    for quantity, unit in (("cpu", "cores"), ("memory", "mib")):
        for name in stood[0][quantity]:
            values = [case[quantity][name] for case in stood if name in case[quantity]]
            figures[f"{quantity}_{name}_{unit}"] = float(np.mean(values))
    others = [other for case in stood for other in case["others"]]
    if others:
        figures |= tails(others, "others_")
        figures["others_missed_fraction"] = max(other["missed_fraction"] for other in others)
    return figures


def judge(figures: dict[str, float]) -> tuple[bool, list[str]]:
    """Hold the figures of a scenario against the bounds; a line for each."""
    if figures["stood_fraction"] < 1.0:
        return False, [f"FAILS: stood_fraction {figures['stood_fraction']:.4g} < 1"]
    bounds = (
        ("p50_us", figures["p50_bound_us"]),
        ("p99_us", figures["p99_bound_us"]),
        ("missed_fraction", latency_config().missed_bound),
    )
    held = [figures[name] < bound for name, bound in bounds]
    lines = [
        f"{'holds' if good else 'FAILS'}: {name} {figures[name]:.4g} < {bound:.4g}"
        for (name, bound), good in zip(bounds, held, strict=True)
    ]
    return all(held), lines


def verdict(held: dict[str, bool], machine: Machine) -> list[str]:
    """Whether this machine keeps real time in each scenario, and what would help."""
    good = [name for name, fine in held.items() if fine]
    bad = [name for name in held if name not in good]
    lines = [f"this machine keeps real time: {', '.join(good)}"] if good else []
    lines += [f"this machine does NOT keep real time: {', '.join(bad)}"] if bad else []
    return lines + [f"advice: {line}" for line in advice(machine)]


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw the distributions of latency and floor, and what the stages take; returns the files written."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(dict.fromkeys(case.get("scenario", "idle") for case in report.cases))
    figure, axes = pyplot.subplots(figsize=(8, 4.5))
    _draw_tail(axes, report.cases, "floor", "ping-pong floor", color="0.5")
    for name in names:
        of = [case for case in report.cases if case.get("scenario", "idle") == name]
        _draw_tail(axes, of, "latency", "sensor to command" if names == ["idle"] else name)
    axes.set(xscale="log", yscale="log", xlabel="time [us]", ylabel="share of ticks that took longer", ylim=(1e-4, 1))
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend(fontsize=8)
    files = [folder / "latency.png"]
    figure.savefig(files[0], dpi=120, bbox_inches="tight")
    pyplot.close(figure)
    staged = [name for name in names if not math.isnan(_stage(report, name, STAGES[0], "p50"))]
    if not staged:
        return files
    figure, pair = pyplot.subplots(1, 2, figsize=(10, 1.5 + 0.4 * len(staged)), sharey=True)
    for axes, part in zip(pair, ("p50", "p99"), strict=True):
        left = np.zeros(len(staged))
        for stage in STAGES:
            width = np.array([_stage(report, name, stage, part) for name in staged])
            axes.barh(staged, width, left=left, label=stage.replace("_", " "))
            left += width
        axes.set_xlabel(f"{part} of each stage, added [us]")
        axes.invert_yaxis()
    pair[1].legend(fontsize=7, bbox_to_anchor=(1.0, 1.0), loc="upper left")
    files.append(folder / "latency-stages.png")
    figure.savefig(files[1], dpi=120, bbox_inches="tight")
    pyplot.close(figure)
    return files


def _stage(report: Report, scenario: str, stage: str, part: str) -> float:
    prefix = "" if scenario == "idle" else f"{scenario}_"
    return report.figures.get(f"{prefix}stage_{stage}_{part}_us", math.nan)


def _draw_tail(axes: Any, cases: list[Case], name: str, label: str, **style: Any) -> None:
    spreads = [found for case in cases if (found := spread_of(case, name)) is not None]
    if spreads:
        axes.plot(percentiles_of(spreads), 1.0 - np.array(QUANTILES) / 100.0, label=label, **style)
