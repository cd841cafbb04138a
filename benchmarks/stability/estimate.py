"""Error of the state estimator in five scenarios, consistency of its covariance, and time of its step.

The normalised estimation error squared (NEES) of n components, e' P^-1 e, is n on average when the covariance P is
consistent. Errors of one run are correlated in time (an encoder's offset stays), so it is averaged over independent
runs: at one instant, N times that mean has chi^2 with N n degrees of freedom. The mean over the instants is held
against the same interval: it scatters as much where errors last as long as the run (tilt) and less where they do not
(velocity). Outside it, on either side, the bench fails.

References:
    Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with applications to tracking and navigation", 2001, 5.4.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from benchmarks.core.benchmark import Benchmark, Bound, at_most, saved
from benchmarks.core.harness import Case, LoadMeter, Options, Report, run_cases
from benchmarks.stability.estimate_runs import PARTS, EstimateConfig, estimate_config, measure, scenarios, time_steps
from bridge.plots import new_figure

WALK = "walk"


def interval(size: int, runs: int, confidence: float) -> tuple[float, float]:
    """Two-sided interval of the mean over ``runs`` of the NEES of ``size`` components."""
    tails = (0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence)
    low, high = (float(chi2.ppf(tail, size * runs)) / runs for tail in tails)
    return low, high


def mean_nees(cases: list[Case], part: str) -> NDArray[np.float64]:
    """NEES of a part at every instant, averaged over the runs of one scenario (n,)."""
    count = min(len(case["nees"][part]) for case in cases)
    return np.asarray(np.mean([case["nees"][part][:count] for case in cases], axis=0))


def drift(case: Case) -> float:
    """Growth of the position's error in parts of the distance walked [-]."""
    return float(np.linalg.norm(case["drift"]) / case["distance"])


def summarise(results: list[Case], config: EstimateConfig) -> dict[str, float]:
    """Figures of all runs: errors of the worst seed, and where no scenario is named, of the worst but for walking."""
    figures: dict[str, float] = {}
    groups = {name: [case for case in results if case["scenario"] == name] for name in scenarios()}
    errors = ("velocity_rmse", "tilt_rmse_deg", "height_rmse")
    for error in errors:
        worst = {name: max(case[error] for case in cases) for name, cases in groups.items()}
        figures[error] = max(value for name, value in worst.items() if name != WALK)
        figures |= {f"{error}_{name}": value for name, value in worst.items()}
    walks = groups[WALK]
    figures["drift"] = max(drift(case) for case in walks)
    figures["drift_median"] = float(np.median([drift(case) for case in walks]))
    figures["drift_horizontal"] = max(float(np.linalg.norm(case["drift"][:2])) / case["distance"] for case in walks)
    figures["drift_height_mean_m"] = float(np.mean([case["drift"][2] for case in walks]))
    figures["walk_distance_m"] = float(np.median([case["distance"] for case in walks]))
    for part, rows in PARTS.items():
        for name, cases in groups.items():
            values = mean_nees(cases, part)
            low, high = interval(rows.size, len(cases), config.confidence)
            figures[f"nees_{part}_{name}"] = float(values.mean())
            figures[f"nees_{part}_{name}_below"] = float((values < low).mean())
            figures[f"nees_{part}_{name}_above"] = float((values > high).mean())
    figures["fallen"] = float(sum(not case["ok"] for case in results))
    return figures


class Estimate(Benchmark):
    """Time the step with nothing else running, then measure every scenario with every seed."""

    measure = staticmethod(measure)

    def cases(self, options: Options) -> list[Case]:
        """Every scenario of every seed."""
        seeds = range(options.seeds)
        return [{"robot": options.robot, "seed": seed, "scenario": name} for seed in seeds for name in scenarios()]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """See ``summarise``."""
        return summarise(cases, estimate_config())

    def bounds(self, report: Report) -> dict[str, Bound]:
        """Errors, drift, time and allocations of a step, no fall, and an honest covariance."""
        config = estimate_config()
        limits = {
            "velocity_rmse": config.velocity_rmse_max,
            "tilt_rmse_deg": config.tilt_rmse_max,
            "height_rmse": config.height_rmse_max,
            "velocity_rmse_walk": config.walk_velocity_rmse_max,
            "drift": config.drift_max,
            "estimator_us_p50": config.step_us_max,
            "allocated_blocks_growth": config.growth_max,
            "fallen": 0.0,
        }
        honest = {
            f"nees_{part}_{name}": Bound(*interval(rows.size, report.seeds, config.confidence))
            for part, rows in PARTS.items()
            for name in scenarios()
        }
        return at_most(limits) | honest

    def notes(self, report: Report) -> list[str]:
        """The bounds, and who fell."""
        fell = [case for case in report.cases if not case["ok"]]
        return super().notes(report) + [
            f"fell: {case['scenario']} seed {case['seed']}: {case['reason']}" for case in fell
        ]

    def survived(self, case: Case) -> tuple[str, bool]:
        """By scenario."""
        return case["scenario"], bool(case["ok"])

    def run(self, options: Options) -> Report:
        """See the class; the time of a step is a separate case ``estimate_step``, not in the report."""
        load = LoadMeter()
        step = [{"robot": options.robot}]
        timed = run_cases(time_steps, step, bench="estimate_step", options=options, alone=True)[0]
        results = run_cases(self.measure, self.cases(options), bench=self.name, options=options)
        timed.pop("robot")
        return self.report(options, results, self.figures(results) | timed, load)

    def plots(self, report: Report, folder: Path) -> list[Path]:
        """Draw the errors of seed 0 with their two-sigma bands, and the NEES with its interval, over time."""
        return [_plot_errors(report, folder), _plot_nees(report, folder)]


def _plot_errors(report: Report, folder: Path) -> Path:
    names = list(scenarios())
    labels = ("height [mm]", "roll [mrad]", "pitch [mrad]", "v x [mm/s]", "v y [mm/s]", "v z [mm/s]")
    figure = new_figure(14.0, 9.0)
    grid = figure.subplots(len(labels), len(names), sharex="col", squeeze=False)
    traces = {case["scenario"]: case["trace"] for case in report.cases if "trace" in case}
    for column, name in enumerate(names):
        t = np.array(traces[name]["t"])
        error, sigma = 1e3 * np.array(traces[name]["error"]), 1e3 * np.array(traces[name]["sigma"])
        for row, label in enumerate(labels):
            axes = grid[row, column]
            axes.fill_between(t, -2.0 * sigma[:, row], 2.0 * sigma[:, row], color="#1b6ca8", alpha=0.15, linewidth=0.0)
            axes.plot(t, error[:, row], color="#1b6ca8", linewidth=0.6)
            axes.tick_params(labelsize=7)
            if column == 0:
                axes.set_ylabel(label, fontsize=8)
        grid[0, column].set_title(name, fontsize=9)
        grid[-1, column].set_xlabel("time [s]", fontsize=8)
    figure.suptitle(f"{report.robot}: error of the estimate, band of two standard deviations, seed 0", fontsize=10)
    return saved(figure, folder / f"estimate-{report.robot}-errors.png")


def _plot_nees(report: Report, folder: Path) -> Path:
    config, names = estimate_config(), list(scenarios())
    figure = new_figure(14.0, 7.0)
    grid = figure.subplots(len(PARTS), len(names), sharex="col", sharey="row", squeeze=False)
    for column, name in enumerate(names):
        cases = [case for case in report.cases if case["scenario"] == name]
        for row, (part, rows) in enumerate(PARTS.items()):
            axes, values = grid[row, column], mean_nees(cases, part)
            axes.axhspan(*interval(rows.size, len(cases), config.confidence), color="0.85")
            axes.axhline(float(rows.size), color="0.5", linewidth=0.8)
            axes.plot(cases[0]["instants"][: values.size], values, color="#1b6ca8", linewidth=1.0)
            axes.set_ylim(bottom=0.0)
            axes.tick_params(labelsize=7)
            if column == 0:
                axes.set_ylabel(f"{part} ({rows.size})", fontsize=8)
        grid[0, column].set_title(name, fontsize=9)
        grid[-1, column].set_xlabel("time [s]", fontsize=8)
    share = f"{100.0 * config.confidence:.0f} %"
    figure.suptitle(f"{report.robot}: mean NEES of {report.seeds} runs and its {share} interval", fontsize=10)
    return saved(figure, folder / f"estimate-{report.robot}-nees.png")
