"""Latency from sensor stamp to received command over ROS 2, compared with the ping-pong floor of the same run.

A case measures floor, graph and floor again, in real time. The bridge records when it publishes the sensors of a tick
and when the command arrives; the control process records the end of each stage (``timed_control.py``). Missed ticks
are ticks without a command and ticks that the bridge skipped because it was late; a command later than a tick takes
effect one step later. Every graph must stand. Only the idle graph has time bounds, relative to the floor; the verdict
on the machine judges the times of the other scenarios.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.core.benchmark import Benchmark, Bound, at_least, at_most, by_scenario, saved
from benchmarks.core.harness import Case, Options, Report, chosen
from benchmarks.core.machine import Machine, advice, read_machine
from benchmarks.core.timed_run import MICRO, QUANTILES, Spread, percentiles_of, spread
from benchmarks.graph import pingpong
from benchmarks.graph.graph_run import Run, latency_config, run_graphs
from bridge.analysis.plots import new_figure
from bridge.driver.probes import ARRIVED, COMMANDED, ESTIMATED, LEFT, PLANNED, RIGHT, SOLVED, STAMP, LatencyProbe, cost
from bridge.ros.environment import free_domain
from models.constants import NANOSECONDS
from models.errors import PoiseError
from models.types import Matrix, Vector

STAGES = (
    "sensors",
    "sensor_transport",
    "estimator",
    "planner",
    "qp",
    "command",
    "command_transport",
    "driver",
)
"""Consecutive stages of a tick:

sensors: reading, encoding and publishing; sensor_transport: until the control process takes the joints from the
middleware; estimator: until the state is passed on, including the wait for overtaken samples; planner: until the gait
reference is available (standing: only the transfer); qp: the rest of the law's tick; command: encoding and publishing;
command_transport: until the bridge takes the command from the middleware; driver: until the drivers accept it.
"""


@dataclass(frozen=True, slots=True)
class Ticks:
    """Ticks of a run with complete records."""

    total: Vector  #: From just before the sensors are published until the drivers have the command (n,) [us]
    stages: Matrix  #: Durations of ``STAGES`` (n, 8) [us]
    contacts: NDArray[np.uint8]  #: Feet in contact (n,), as bits of ``bridge/driver/probes.py``


def answered(rows: Mapping[str, NDArray[Any]], skip: int) -> tuple[NDArray[np.int64], Vector, float]:
    """Return answered ticks (n,) after the first ``skip``, lateness of all ticks (m,) [us], and missed fraction."""
    active = np.flatnonzero(rows["active"])[skip:]
    active = active[:-1]  # the answer to the last tick may be after the end
    if len(active) == 0:
        return active, np.zeros(0), 1.0
    good = rows["received"][active] > 0
    # Sensors may be published only every few ticks; a skipped period of the sensors is one missed tick.
    period = max(round(float(np.median(np.diff(active)))), 1) if len(active) > 1 else 1
    skipped = int(rows["skipped"][active[0] : active[-1] + 1].sum()) / period
    missed = (np.count_nonzero(~good) + skipped) / (len(active) + skipped)
    return active[good], rows["late"][active] * 1e6, float(missed)


def split(bridge: Mapping[str, NDArray[Any]], laws: Mapping[str, NDArray[Any]], skip: int, period_ns: int) -> Ticks:
    """Join the rows of both processes by the stamp of the sensors; overlapping calls count as publishing."""
    ticks, _, _ = answered(bridge, skip)
    table = laws["stages"]
    whole = np.flatnonzero(table[:, STAMP : COMMANDED + 1].all(axis=1))
    of_tick = np.full(len(bridge["published"]), -1, dtype=np.int64)
    numbers = table[whole, STAMP] // period_ns
    inside = (numbers >= 0) & (numbers < len(of_tick))
    of_tick[numbers[inside]] = whole[inside]
    ticks = ticks[of_tick[ticks] >= 0]
    row = table[of_tick[ticks]]
    begin, end, came = (bridge[name][ticks] for name in ("published", "received", "arrived"))
    moments = np.column_stack(
        (
            begin,
            np.minimum(bridge["sent"][ticks], row[:, ARRIVED]),
            row[:, ARRIVED],
            row[:, ESTIMATED],
            row[:, PLANNED],
            row[:, SOLVED],
            np.minimum(row[:, COMMANDED], came),
            came,
            end,
        )
    )
    return Ticks((end - begin) * MICRO, np.diff(moments, axis=1) * MICRO, laws["contacts"][of_tick[ticks]])


def tails(spreads: Sequence[Spread], prefix: str) -> dict[str, float]:
    """Return median, 99th and 99.9th percentile and maximum as figures ``<prefix>p50_us`` and so on [us]."""
    percents = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "max": 100.0}
    found = percentiles_of(spreads, list(percents.values()))
    return {f"{prefix}{label}_us": float(value) for label, value in zip(percents, found, strict=True)}


TICK = 0.001  # period of physics and drivers [s]

#: Contacts of the ticks in the figures ``<scenario>_single_`` and ``_double_``
SUPPORTS = {"single": (LEFT, RIGHT), "double": (LEFT | RIGHT,)}


def _measure(robot: str, seed: int, scenario: str) -> Case:
    """Measure one case; if a graph does not start or ends early, the reason is in ``failure``."""
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
    if (stood := min(map(_active_time, runs))) < config.duration:
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
    """Return the latency of every answered tick [us], and the missed fraction."""
    rows = probe.rows()
    ticks, _, missed = answered(rows, skip)
    return (rows["received"][ticks] - rows["published"][ticks]) * 1e-3, missed


def _active_time(run: Run) -> float:
    """Return the time from the first to the last tick at which the drivers executed commands [s]."""
    times = run.bridge["published"][run.bridge["active"]]
    return float(np.ptp(times)) / NANOSECONDS if len(times) else 0.0


def _case(run: Run, skip: int, tick: float) -> Case:
    """Return the case of one graph, without the first ``skip`` ticks; ``tick`` is the period of the sensors [s]."""
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
    """Compute the figures of a scenario, one case per seed; ``tick`` is the real-time period of the sensors [s]."""
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


TIMES = ("p50_us", "p99_us")  # figures with a bound relative to the floor of the same run


def bounds_of_graph(figures: dict[str, float]) -> dict[str, Bound]:
    """Return the bounds of one scenario's figures."""
    limits: dict[str, float] = {name: figures[f"{name[:3]}_bound_us"] for name in TIMES if name in figures}
    return at_least({"stood_fraction": 1.0}) | at_most({**limits, "missed_fraction": latency_config().missed_bound})


def judge(figures: dict[str, float]) -> tuple[bool, list[str]]:
    """Compare the figures of a scenario with the bounds; returns the verdict and a line per bound."""
    held, lines = True, []
    for name, bound in bounds_of_graph(figures).items():
        if name in figures:
            good = bound.holds(figures[name])
            held &= good
            lines.append(f"{'holds' if good else 'FAILS'}: {name} {figures[name]:.4g} {bound}")
    return held, lines


def verdict(held: dict[str, bool], machine: Machine) -> list[str]:
    """Return whether this machine keeps real time in each scenario, and advice."""
    good = [name for name, fine in held.items() if fine]
    bad = [name for name in held if name not in good]
    lines = [f"this machine keeps real time: {', '.join(good)}"] if good else []
    lines += [f"this machine does NOT keep real time: {', '.join(bad)}"] if bad else []
    return lines + [f"advice: {line}" for line in advice(machine)]


def _prefix(scenario: str) -> str:
    return "" if scenario == "idle" else f"{scenario}_"


def _of(report: Report, scenario: str) -> dict[str, float]:
    """Return the figures of one scenario, without its prefix."""
    prefix = _prefix(scenario)
    return {name.removeprefix(prefix): value for name, value in report.figures.items() if name.startswith(prefix)}


class Latency(Benchmark):
    """See the docstring of the module."""

    alone = True
    measure = staticmethod(_measure)

    def cases(self, options: Options) -> list[Case]:
        config = latency_config()
        names = chosen("latency", options.scenarios, list(config.scenarios), config.usual)
        return [
            {"robot": options.robot, "seed": seed, "scenario": name} for name in names for seed in options.each_seed()
        ]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return the figures of each scenario, prefixed with its name unless 'idle', and the time of the stamps."""
        figures: dict[str, float] = {}
        for name, of in by_scenario(cases).items():
            scenario = latency_config().scenarios[name]
            found = summarise(of, 1.0 / (scenario.rate * scenario.speed))
            figures |= {f"{_prefix(name)}{key}": value for key, value in found.items()}
        return figures | {"stamps_us": cost() * 1e6}

    def bounds(self, report: Report) -> dict[str, Bound]:
        return {
            f"{_prefix(name)}{key}": bound
            for name in by_scenario(report.cases)
            for key, bound in bounds_of_graph(_of(report, name)).items()
            if name in latency_config().usual or key == "stood_fraction"
        }

    def notes(self, report: Report) -> list[str]:
        notes, held_by = [], {}
        for name, of in by_scenario(report.cases).items():
            speed = latency_config().scenarios[name].speed
            held, lines = judge(_of(report, name))
            held_by[name if speed == 1.0 else f"{name} at {speed:g} of real time"] = held
            lines += [f"seed {case['seed']}: {case['failure']}" for case in of if "failure" in case]
            notes += [f"{name}: {line}" for line in lines]
        return notes + verdict(held_by, read_machine())

    def plots(self, report: Report, folder: Path) -> list[Path]:
        groups = by_scenario(report.cases)
        figure = new_figure(8.0, 4.5)
        axes = figure.add_subplot()
        _draw_tail(axes, report.cases, "floor", "ping-pong floor", color="0.5")
        for name, of in groups.items():
            _draw_tail(axes, of, "latency", "sensor to command" if list(groups) == ["idle"] else name)
        axes.set(
            xscale="log", yscale="log", xlabel="time [us]", ylabel="share of ticks that took longer", ylim=(1e-4, 1)
        )
        axes.grid(visible=True, which="both", alpha=0.3)
        axes.legend(fontsize=8)
        files = [saved(figure, folder / f"latency-{report.stem}.png")]
        staged = [name for name in groups if not math.isnan(_stage(report, name, STAGES[0], "p50"))]
        if not staged:
            return files
        figure = new_figure(10.0, 1.5 + 0.4 * len(staged))
        pair = figure.subplots(1, 2, sharey=True)
        for axes, part in zip(pair, ("p50", "p99"), strict=True):
            left = np.zeros(len(staged))
            for stage in STAGES:
                width = np.array([_stage(report, name, stage, part) for name in staged])
                axes.barh(staged, width, left=left, label=stage.replace("_", " "))
                left += width
            axes.set_xlabel(f"{part} of each stage, added [us]")
            axes.invert_yaxis()
        pair[1].legend(fontsize=7, bbox_to_anchor=(1.0, 1.0), loc="upper left")
        return [*files, saved(figure, folder / f"latency-stages-{report.stem}.png")]


def _stage(report: Report, scenario: str, stage: str, part: str) -> float:
    return report.figures.get(f"{_prefix(scenario)}stage_{stage}_{part}_us", math.nan)


def _draw_tail(axes: Any, cases: list[Case], name: str, label: str, **style: Any) -> None:
    spreads = [case["spreads"][name] for case in cases if name in case.get("spreads", {})]
    if spreads:
        axes.plot(percentiles_of(spreads), 1.0 - np.array(QUANTILES) / 100.0, label=label, **style)
