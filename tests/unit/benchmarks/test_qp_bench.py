"""The QP benchmark: an answer is certified by what it is, not by who gave it, and problems survive their archive."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.core.benchmark import catalogue
from benchmarks.core.harness import Options, Sweep, read_json, write_json
from benchmarks.core.results import ResultsFile
from benchmarks.speed import qp
from benchmarks.speed.qp import (
    BACKENDS,
    OWN,
    RecordedQP,
    available,
    certify,
    copied,
    own_solver,
    qp_config,
    read,
    solve_all,
    summarise,
    through_qpsolvers,
    write,
)
from bridge.analysis.plots import new_figure
from controllers.balance.controller import BalanceController
from controllers.qp.active_set import QP
from models.errors import ConfigError
from models.robot_model import RobotModel
from tests.support import standing

TOLERANCE = qp_config().active_tolerances


def small() -> QP:
    """Minimise |z - (2, 1)|^2 / 2 with z_1 <= 1 (simple) and z_1 + z_2 >= -5: the minimum is (1, 1)."""
    return QP(
        np.eye(2),
        np.array([-2.0, -1.0]),
        np.array([[1.0, 0.0], [1.0, 1.0]]),
        np.array([-1e30, -5.0]),
        np.array([1.0, 1e30]),
        np.array([False, False]),
    )


def test_a_minimiser_is_certified_and_others_are_not() -> None:
    best = certify(small(), np.array([1.0, 1.0]), TOLERANCE)
    assert max(best.primal, best.dual, best.gap) < 1e-12
    assert certify(small(), np.array([2.0, 1.0]), TOLERANCE).primal == pytest.approx(1.0 / 3.0)
    assert certify(small(), np.array([1.0, 0.9]), TOLERANCE).dual > 0.01
    assert certify(small(), np.array([0.5, 1.0]), TOLERANCE).dual > 0.1  # the multiplier of a row that is not active
    for nothing in (None, np.array([np.nan, 1.0])):
        assert certify(small(), nothing, TOLERANCE).primal == np.inf


def test_a_multiplier_of_the_wrong_sign_certifies_nothing() -> None:
    qp = small()
    qp.gradient[:] = 0.0, -1.0  # drawn to (0, 1): the row z_1 <= 1 pushes the wrong way at (1, 1)
    assert certify(qp, np.array([1.0, 1.0]), TOLERANCE).dual > 0.1


@pytest.fixture(scope="module")
def problems() -> list[RecordedQP]:
    """QPs of ticks of a standing robot that moves a little, joint by joint."""
    model = RobotModel.load("g1")
    controller = BalanceController(model)
    rng = np.random.default_rng(0)
    still = model.standing_configuration()
    controller.reset(standing(model, 0.0))
    found = []
    for k in range(5):
        q = still.copy()
        q[7:] += 0.003 * rng.normal(size=model.nj)
        controller.step(standing(model, 0.001 * k, q=q, v=0.5 * rng.normal(size=model.nv)), 0.001)
        problem, z = controller.whole_body.problem, controller.whole_body.solution.z
        assert problem is not None and z is not None
        found.append(RecordedQP("standing", copied(problem), z.copy()))
    return found


def test_the_own_solver_is_certified_on_problems_of_ticks(problems: list[RecordedQP]) -> None:
    own = own_solver()
    for problem in problems:
        proof = certify(problem.qp, own.solve(problem.qp).z, TOLERANCE)
        assert max(proof.primal, proof.dual) < qp_config().residual_max


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_backend_finds_the_same_minimum(backend: str, problems: list[RecordedQP]) -> None:
    if backend not in available()[0]:
        pytest.skip(f"{backend} is not installed")
    for problem in problems[:2]:
        z = through_qpsolvers(problem.qp, backend)()
        assert z is not None
        np.testing.assert_allclose(z, problem.solution, atol=1e-3 * (1.0 + np.abs(problem.solution).max()))


def test_problems_survive_their_archive(problems: list[RecordedQP], tmp_path: Path) -> None:
    write(tmp_path / "qps.npz", problems)
    again = read(tmp_path / "qps.npz")
    assert [problem.scenario for problem in again] == ["standing"] * 5
    np.testing.assert_array_equal(again[3].qp.hessian, problems[3].qp.hessian)
    np.testing.assert_array_equal(again[3].solution, problems[3].solution)
    (tmp_path / "none.npz").write_text("nothing")
    with pytest.raises(ConfigError, match="not an archive of QPs"):
        read(tmp_path / "none.npz")


def test_figures_tell_who_solved_what(problems: list[RecordedQP]) -> None:
    cases = solve_all(problems, [OWN], 0)
    figures = summarise(cases, [OWN])
    assert figures["poise_solved"] == 1.0 and figures["poise_ratio"] == 1.0
    assert figures["poise_standing_us_p50"] == figures["poise_us_p50"] > 0.0
    assert figures["poise_primal_max"] < qp_config().residual_max
    cases[0]["primal"][0] = np.inf
    assert summarise(cases, [OWN])["poise_solved"] == pytest.approx(0.8)


@pytest.mark.long
def test_a_rerun_reads_what_was_solved(
    problems: list[RecordedQP], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded: list[int] = []

    def record(robot: str, seed: int, config: object) -> list[RecordedQP]:
        recorded.append(seed)
        return problems

    monkeypatch.setattr(qp, "record", record)
    monkeypatch.setattr(qp, "available", lambda: ([], []))
    monkeypatch.setattr(qp, "gettempdir", lambda: str(tmp_path))
    reports = []
    for seeds in (1, 2, 2):
        with ResultsFile(tmp_path / "cases.jsonl") as file:
            reports.append(catalogue()["qp"].load().run(Options(seeds=seeds, sweep=Sweep(None, file))))
    assert recorded == [0, 1]
    archives = [report.notes[1].removeprefix("problems: ") for report in reports[:2]]
    assert sorted(map(str, tmp_path.glob("qps-g1-*.npz"))) == sorted(
        archives
    )  # one a run that measured, none in common
    assert len(reports[2].notes) == 1
    first, _, again = reports
    assert again.figures == reports[1].figures and again.cases[0] == first.cases[0]
    assert [(case["seed"], case["solver"]) for case in again.cases] == [(0, OWN), (1, OWN)]
    again.cases[0]["primal"][0] = np.inf  # no answer, which a report has as null
    write_json(again, tmp_path / "qp.json")
    figure = new_figure(8.0, 4.5)
    monkeypatch.setattr(qp, "new_figure", lambda width, height: figure)
    assert catalogue()["qp"].load().plots(read_json(tmp_path / "qp.json"), tmp_path)[0].is_file()
    residual = np.asarray(figure.axes[0].lines[0].get_ydata())
    assert np.isnan(residual[0]) and np.isfinite(residual[1:]).all()  # not drawn, instead of exact


def test_backends_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("qpsolvers.available_solvers", ["osqp"])
    found, missing = available()
    assert found == ["daqp", "osqp"] and set(missing) == set(BACKENDS) - {"daqp", "osqp"}
