"""QPs of real ticks: poise's own solver beside the back-ends of qpsolvers, time and residuals of every answer.

The problems are recorded in the closed loop: standing, single support, and pushed while it waves. Every solver gets
each of them in turn, in an order that changes, several times; the fastest time of a problem counts. Poise's solver
starts from the rows that were active on the tick before, as it does in the tick; the others start cold, as qpsolvers
has them, and their times include what qpsolvers adds in Python. Answers are certified alike (``qp_solvers.certify``).
"""

from __future__ import annotations

import math
from functools import partial
from itertools import cycle
from pathlib import Path
from tempfile import gettempdir
from uuid import uuid4

import numpy as np

from benchmarks.harness import Case, LoadMeter, Options, Report, percentiles, run_cases
from benchmarks.qp_records import RecordedQP, qp_config, record, write
from benchmarks.qp_solvers import OWN, Solve, available, certify, own_solver, through_qpsolvers, timed
from benchmarks.timed_run import collector_off
from bridge.plots import new_figure
from controllers.qp.solve import QPSolver


def run(options: Options) -> Report:
    """Record and solve, once a seed.

    Args:
        options: Robot and seeds.

    Returns:
        Of every solver and scenario median and tails of the time ``<solver>_<scenario>_us_p50`` ..., over all of them
        ``<solver>_us_p50`` ..., the worst ``<solver>_primal_max``, ``_dual_max`` and ``_gap_max``, the share
        ``_solved`` of problems, and ``<solver>_ratio``: its median over that of poise.
    """
    load, (backends, missing) = LoadMeter(), available()
    names = [OWN, *backends]
    inputs = [{"robot": options.robot, "seed": seed, "solvers": names} for seed in range(options.seeds)]
    file = _problems_file(options.robot)
    runs = run_cases(partial(_measure, file), inputs, bench="qp", options=options, alone=True)
    cases: list[Case] = [case for run in runs for case in run["answers"]]
    figures = summarise(cases, names)
    notes = [f"problems: {file}"] if file.is_file() else []  # none where every case was there already
    if missing:
        notes.append(f"left out, not installed: {', '.join(missing)} (the extra 'bench' has them)")
    passed = figures[f"{OWN}_solved"] == 1.0
    return Report("qp", options.robot, options.seeds, figures, cases, passed, load.read(), notes)


def _problems_file(robot: str) -> Path:
    """Where the problems of the last seed are left for whoever wants to look at them; another place for every run."""
    return Path(gettempdir()) / f"qps-{robot}-{uuid4().hex}.npz"


def _measure(file: Path, robot: str, seed: int, solvers: list[str]) -> Case:
    """Record the problems of a seed, and solve them."""
    problems = record(robot, seed, qp_config())
    write(file, problems)
    return {"robot": robot, "seed": seed, "answers": solve_all(problems, solvers, seed)}


def solve_all(problems: list[RecordedQP], names: list[str], seed: int) -> list[Case]:
    """Solve every problem with every solver, in turn.

    Returns:
        One case a solver and scenario: ``times`` [us], ``primal``, ``dual``, ``gap`` of every problem.
    """
    config, own = qp_config(), own_solver()
    shape = len(problems), len(names)
    times = np.full(shape, math.inf)
    answers: dict[tuple[int, int], np.ndarray | None] = {}
    turns = cycle(range(len(names)))
    with collector_off():
        for repeat in range(config.repeats):
            own.reset()
            for index, problem in enumerate(problems):
                first = next(turns)
                for k in range(len(names)):
                    which = (first + k) % len(names)
                    solve = _solve(names[which], problem, own)
                    z, time = timed(solve)
                    times[index, which] = min(times[index, which], time)
                    if repeat == 0:
                        answers[index, which] = z
    cases: list[Case] = []
    for which, name in enumerate(names):
        for scenario in dict.fromkeys(problem.scenario for problem in problems):
            of = [index for index, problem in enumerate(problems) if problem.scenario == scenario]
            proofs = [certify(problems[index].qp, answers[index, which], config.active_tolerances) for index in of]
            case: Case = {"solver": name, "scenario": scenario, "seed": seed, "times": times[of, which]}
            for part in ("primal", "dual", "gap"):
                case[part] = np.array([getattr(proof, part) for proof in proofs])
            cases.append(case)
    return cases


def _solve(name: str, problem: RecordedQP, own: QPSolver) -> Solve:
    if name != OWN:
        return through_qpsolvers(problem.qp, name, qp_config().options.get(name, {}))
    return lambda: own.solve(problem.qp).z


def summarise(cases: list[Case], names: list[str]) -> dict[str, float]:
    """Figures of the cases; see ``run``."""
    limit = qp_config().residual_max
    figures: dict[str, float] = {}
    for name in names:
        of = [case for case in cases if case["solver"] == name]
        figures |= percentiles(np.concatenate([case["times"] for case in of]), f"{name}_us")
        for scenario in dict.fromkeys(case["scenario"] for case in of):
            chosen = [case["times"] for case in of if case["scenario"] == scenario]
            figures |= percentiles(np.concatenate(chosen), f"{name}_{scenario}_us")
        pooled = {part: np.concatenate([case[part] for case in of]) for part in ("primal", "dual", "gap")}
        solved = np.max([pooled[part] for part in pooled], axis=0) <= limit
        figures[f"{name}_solved"] = float(solved.mean())
        for part, values in pooled.items():
            figures[f"{name}_{part}_max"] = float(values.max())
        figures[f"{name}_ratio"] = figures[f"{name}_us_p50"] / figures[f"{OWN}_us_p50"]
    return figures


def plot(report: Report, folder: Path) -> list[Path]:
    """Draw time against the worse of the residuals, one colour a solver; returns the file written."""
    figure = new_figure(8.0, 4.5)
    axes = figure.add_subplot(1, 1, 1)
    for name in dict.fromkeys(case["solver"] for case in report.cases):
        of = [case for case in report.cases if case["solver"] == name]
        times = np.concatenate([np.asarray(case["times"]) for case in of])
        residual = np.concatenate([np.maximum(case["primal"], case["dual"]) for case in of])
        # 1e-16: exact answers. What has no answer is infinite, or not a number from a report, and is not drawn.
        axes.loglog(times, np.maximum(residual, 1e-16), ".", markersize=3, label=name)
    axes.axhline(qp_config().residual_max, color="0.5", linewidth=0.8, linestyle="--")
    axes.set_xlabel("time [us]")
    axes.set_ylabel("larger of primal and dual residual")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    axes.set_title(f"{report.robot}: QPs of real ticks", fontsize=10)
    file = folder / f"qp-{report.robot}.png"
    figure.savefig(file, dpi=110)
    return [file]
