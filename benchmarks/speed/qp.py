"""QPs of real ticks: time and residuals of poise's solver and of the back-ends of qpsolvers.

Every solver solves each problem several times, in changing order; the shortest time counts. Poise's solver is warm
started with the active rows of the previous tick, as in the controller. The others start cold, and their times include
the Python code of qpsolvers. All answers are certified alike (``certify``).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import cycle
from pathlib import Path
from tempfile import gettempdir
from time import perf_counter_ns
from uuid import uuid4

import numpy as np
from pydantic.dataclasses import dataclass as schema
from scipy.optimize import nnls

from benchmarks.core.benchmark import Benchmark, by_scenario, saved, settings
from benchmarks.core.harness import Case, LoadMeter, Options, Report, percentiles, run_cases
from benchmarks.core.loops import advance, demand, start_walk
from benchmarks.core.timed_run import collector_off
from benchmarks.stability.exercise import exercise_config, push_forces
from bridge.analysis.plots import new_figure
from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from controllers.qp.active_set import QP
from controllers.qp.solve import INFINITE, TOLERANCE, QPSolver, backends, solver_options, to_qpsolvers
from controllers.whole_body.config import SolverConfig, WholeBodyConfig
from controllers.whole_body.controller import WholeBodyController
from models.config import STRICT, Count, Positive, default_config
from models.errors import ConfigError, PoiseError
from models.types import Mode, Vector


@schema(frozen=True, slots=True, config=STRICT)
class QPConfig:
    """Settings of the test; the units are in ``benchmarks/config/qp.yaml``."""

    rows: Count
    ticks: Count
    repeats: Count
    pause: Positive
    pushed_for: Positive
    walk_speed: Positive
    walk_for: Positive
    active_tolerances: tuple[Positive, ...]
    residual_max: Positive


qp_config = partial(settings, QPConfig, "qp")


@dataclass(frozen=True, slots=True)
class RecordedQP:
    """QP of a tick in a scenario ('standing', 'single_support' or 'pushed'), and its solution in that tick (nz,)."""

    scenario: str
    qp: QP
    solution: np.ndarray


def record(robot: str, seed: int, config: QPConfig) -> list[RecordedQP]:
    """Record QPs of consecutive ticks: standing, pushed while waving, and in single support."""
    loop = ClosedLoop(robot=robot, seed=seed, record=False)
    balance = loop.controller
    if not isinstance(balance, BalanceController):
        raise PoiseError(f"{robot}: the controller of the loop is not the whole-body controller")
    found: list[RecordedQP] = []
    for _ in range(config.rows):
        advance(loop, config.pause)
        found += _row("standing", loop, balance.whole_body, config)
    forces, push = push_forces(loop, exercise_config()), exercise_config()
    for k in range(config.rows):
        if loop.mode is Mode.STAND:
            demand(loop, push.motion)
        force = forces[k % len(forces)]
        loop.apply_push((force[0], force[1], force[2]), push.push_duration, push.push_body)
        advance(loop, config.pushed_for)
        found += _row("pushed", loop, balance.whole_body, config)
        advance(loop, push.push_period)
    loop.wait_motion()
    start_walk(loop, config.walk_speed)
    advance(loop, config.walk_for)
    for _ in range(config.rows):
        end = loop.t + config.walk_for
        while sum(loop.stack.reference.contacts) != 1:
            advance(loop, config.pause)
            if loop.t > end:
                raise PoiseError(f"{robot} does not walk at {config.walk_speed} m/s")
        found += _row("single_support", loop, balance.whole_body, config)
        advance(loop, config.pause)
    return found


def _row(scenario: str, loop: ClosedLoop, whole_body: WholeBodyController, config: QPConfig) -> list[RecordedQP]:
    found = []
    for _ in range(config.ticks):
        loop.step()
        qp, z = whole_body.problem, whole_body.solution.z
        if qp is not None and z is not None:
            found.append(RecordedQP(scenario, copied(qp), z.copy()))
    return found


def copied(qp: QP) -> QP:
    """Copy a problem, because the next tick overwrites it."""
    return QP(qp.hessian.copy(), qp.gradient.copy(), qp.matrix.copy(), qp.lower.copy(), qp.upper.copy(), qp.soft.copy())


def write(path: Path, problems: Sequence[RecordedQP]) -> None:
    """Write problems as a NumPy archive."""
    arrays = {
        f"{index}/{name}": getattr(problem.qp, name) for index, problem in enumerate(problems) for name in QP._fields
    }
    arrays |= {f"{index}/solution": problem.solution for index, problem in enumerate(problems)}
    np.savez_compressed(path, allow_pickle=False, scenarios=np.array([p.scenario for p in problems]), **arrays)


def read(path: Path) -> list[RecordedQP]:
    """Read an archive of ``write``; ``ConfigError`` for any other file."""
    try:
        with np.load(path) as data:
            return [
                RecordedQP(
                    str(scenario), QP(*(data[f"{index}/{name}"] for name in QP._fields)), data[f"{index}/solution"]
                )
                for index, scenario in enumerate(data["scenarios"])
            ]
    except (OSError, KeyError, ValueError) as error:
        raise ConfigError(f"{path}: not an archive of QPs: {error}") from error


OWN = "poise"  # the controller's solver
BACKENDS = ("daqp", "quadprog", "proxqp", "piqp", "osqp", "clarabel")  # back-ends of qpsolvers

Solve = Callable[[], Vector | None]


@dataclass(frozen=True, slots=True)
class Certificate:
    """Distance of an answer from the minimiser, relative to the compared values."""

    primal: float  #: Largest constraint violation [-]
    dual: float  #: Largest entry of the gradient of the Lagrangian, with the best multipliers of the correct sign [-]
    gap: float  #: Duality gap with these multipliers [-]


def certify(qp: QP, z: Vector | None, tolerances: Sequence[float]) -> Certificate:
    """Certify an answer (nz,) of any solver, with least-squares multipliers of its active rows.

    A row is active if its relative distance to its bound is within a tolerance [-]. The best tolerance counts, because
    interior-point methods stop at a small distance from the bounds.
    """
    if z is None or not np.isfinite(z).all():
        return Certificate(math.inf, math.inf, math.inf)
    return min((_proof(qp, z, tolerance) for tolerance in tolerances), key=lambda proof: max(proof.dual, proof.gap))


def _proof(qp: QP, z: Vector, tolerance: float) -> Certificate:
    """Compute the certificate for one tolerance of the active rows."""
    rows = qp.matrix
    values = rows @ z
    size = 1.0 + np.abs(values)
    below, above = (qp.lower - values) / size, (values - qp.upper) / size
    slack = max(tolerance, 2.0 * float(max(below.max(), above.max(), 0.0)))
    low, high = (below > -slack) & (qp.lower > -INFINITE), (above > -slack) & (qp.upper < INFINITE)
    normals = np.vstack([-rows[low], rows[high]])  # (active, nz), outward
    gradient = qp.hessian @ z + qp.gradient
    scale = 1.0 + float(np.abs(qp.gradient).max())
    if len(normals):
        multipliers, _ = nnls(normals.T, -gradient, maxiter=50 * len(normals))
        pull = normals.T @ multipliers
        bounds = np.concatenate([-qp.lower[low], qp.upper[high]])
        complementary = float(multipliers @ (bounds - normals @ z))
    else:
        pull, complementary = np.zeros_like(z), 0.0
    residual = gradient + pull
    objective = 0.5 * float(z @ qp.hessian @ z) + float(qp.gradient @ z)
    # Primal minus dual objective for these multipliers: residuals of complementarity and stationarity.
    gap = abs(float(residual @ z)) + abs(complementary)
    return Certificate(
        primal=float(max(below.max(), above.max(), 0.0)),
        dual=float(np.abs(residual).max()) / scale,
        gap=gap / (1.0 + abs(objective)),
    )


def own_solver() -> QPSolver:
    """Return the controller's solver with its configuration."""
    config = _solver_config()
    return QPSolver(config.residual_max, config.iterations_max, config.soft_rho)


@cache
def _solver_config() -> SolverConfig:
    return default_config(WholeBodyConfig, "controllers", "whole_body").solver


def available() -> tuple[list[str], list[str]]:
    """Return the installed and the missing back-ends of ``BACKENDS``."""
    installed = backends()
    return [name for name in BACKENDS if name in installed], [name for name in BACKENDS if name not in installed]


def through_qpsolvers(qp: QP, backend: str) -> Solve:
    """Convert a problem like ``solver.backend``; the returned call solves it and excludes the conversion."""
    import qpsolvers

    problem, _, _ = to_qpsolvers(qp, backend)
    options = solver_options(backend, TOLERANCE * _solver_config().residual_max)

    def solve() -> Vector | None:
        solution = qpsolvers.solve_problem(problem, solver=backend, **options)
        return None if not solution.found or solution.x is None else np.asarray(solution.x)

    return solve


def timed(solve: Solve) -> tuple[Vector | None, float]:
    """Solve once; returns the answer and the time [us]. The answer is None if the back-end raises."""
    start = perf_counter_ns()
    try:
        z = solve()
    except (ValueError, RuntimeError, ArithmeticError):
        z = None
    return z, (perf_counter_ns() - start) * 1e-3


def _measure(file: Path, robot: str, seed: int, solvers: list[str]) -> Case:
    problems = record(robot, seed, qp_config())
    write(file, problems)
    return {"robot": robot, "seed": seed, "answers": solve_all(problems, solvers, seed)}


def solve_all(problems: list[RecordedQP], names: list[str], seed: int) -> list[Case]:
    """Solve all problems with all solvers; ``times`` [us], ``primal``, ``dual``, ``gap`` by solver and scenario."""
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
        return through_qpsolvers(problem.qp, name)
    return lambda: own.solve(problem.qp).z


def summarise(cases: list[Case], names: list[str]) -> dict[str, float]:
    """Compute figures by solver: ``<solver>[_<scenario>]_us_p50`` ..., ``_solved``, ``_ratio``, residuals."""
    limit = qp_config().residual_max
    figures: dict[str, float] = {}
    for name in names:
        of = [case for case in cases if case["solver"] == name]
        figures |= percentiles(np.concatenate([case["times"] for case in of]), f"{name}_us")
        for scenario, each in by_scenario(of).items():
            figures |= percentiles(np.concatenate([case["times"] for case in each]), f"{name}_{scenario}_us")
        pooled = {part: np.concatenate([case[part] for case in of]) for part in ("primal", "dual", "gap")}
        solved = np.max([pooled[part] for part in pooled], axis=0) <= limit
        figures[f"{name}_solved"] = float(solved.mean())
        for part, values in pooled.items():
            figures[f"{name}_{part}_max"] = float(values.max())
        figures[f"{name}_ratio"] = figures[f"{name}_us_p50"] / figures[f"{OWN}_us_p50"]
    return figures


class QPBenchmark(Benchmark):
    """See the docstring of the module. A report has one case per solver, scenario and seed."""

    alone = True

    def cases(self, options: Options) -> list[Case]:
        solvers = [OWN, *available()[0]]
        return [{"robot": options.robot, "seed": seed, "solvers": solvers} for seed in options.each_seed()]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        return summarise(cases, list(dict.fromkeys(case["solver"] for case in cases)))

    def run(self, options: Options) -> Report:
        load, file = LoadMeter(), Path(gettempdir()) / f"qps-{Path(options.robot).stem}-{uuid4().hex}.npz"
        measure = partial(_measure, file)
        runs = run_cases(measure, self.cases(options), bench=self.name, options=options, alone=self.alone)
        cases: list[Case] = [case for run in runs for case in run["answers"]]
        report = self.report(options, cases, self.figures(cases), load)
        if file.is_file():  # missing if every case was in the results file
            report.notes.append(f"problems: {file}")
        if missing := available()[1]:
            report.notes.append(f"left out, not installed: {', '.join(missing)}: pip install 'poise[bench]'")
        return report

    def plots(self, report: Report, folder: Path) -> list[Path]:
        figure = new_figure(8.0, 4.5)
        axes = figure.add_subplot(1, 1, 1)
        for name in dict.fromkeys(case["solver"] for case in report.cases):
            of = [case for case in report.cases if case["solver"] == name]
            times = np.concatenate([np.asarray(case["times"]) for case in of])
            residual = np.concatenate([np.maximum(case["primal"], case["dual"]) for case in of])
            # 1e-16: exact answers. Missing answers are infinite, or NaN in a saved report, and are not drawn.
            axes.loglog(times, np.maximum(residual, 1e-16), ".", markersize=3, label=name)
        axes.axhline(qp_config().residual_max, color="0.5", linewidth=0.8, linestyle="--")
        axes.set(xlabel="time [us]", ylabel="larger of primal and dual residual")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
        axes.set_title(f"{report.robot}: QPs of real ticks", fontsize=10)
        return [saved(figure, folder / f"qp-{report.stem}.png")]
