"""Kernels that replace library calls in the tick, held to those calls."""

import daqp
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.balance.posture_reference import posture_frames, posture_reference
from controllers.qp.active_set import (
    MARKED_MAX,
    QP,
    all_finite,
    free_minimum,
    kkt_residual,
    make_workspace,
    mark_violated,
)
from controllers.qp.solve import QPSolver
from models.robot_model import RobotModel
from models.tree import read_tree
from models.types import SolveStatus


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_posture_reference_equals_pinocchio(robot: str) -> None:
    model = RobotModel.load(robot)
    tree, frames, data, rng = read_tree(model.pin), posture_frames(model), model.data(), np.random.default_rng(1)
    at, base, turned = np.zeros(3), np.eye(3), np.eye(3)
    for k in range(10):
        joints = rng.uniform(model.q_lower, model.q_upper) if k else model.posture("stand")
        posture_reference(joints, tree, frames, at, base, turned)
        q = pin.neutral(model.pin)
        q[7:] = joints
        com = pin.centerOfMass(model.pin, data, q)
        pin.framesForwardKinematics(model.pin, data, q)
        left, right = (data.oMf[foot.frame_id] for foot in model.feet)
        middle = left.rotation @ pin.exp3(0.5 * pin.log3(left.rotation.T @ right.rotation))
        torso = data.oMf[model.frame_id("torso")].rotation
        np.testing.assert_allclose(base, middle.T, atol=1e-10)
        np.testing.assert_allclose(turned, middle.T @ torso, atol=1e-10)
        centre = 0.5 * (left.translation + right.translation)
        np.testing.assert_allclose(at, middle.T @ (com - centre), atol=1e-10)


def random_qp(seed: int, bound: float) -> QP:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(7, 5))
    return QP(
        root.T @ root + 0.1 * np.eye(5),
        rng.normal(size=5),
        np.vstack([np.eye(5)[:2], rng.normal(size=(4, 5))]),
        np.full(6, -bound),
        np.full(6, bound),
        np.zeros(6, dtype=bool),
    )


def without_rows(qp: QP) -> tuple[float, np.ndarray, np.ndarray]:
    """Residual, minimiser and broken rows of the cost alone."""
    z, broken = np.empty(qp.gradient.size), np.zeros(qp.lower.size, dtype=bool)
    residual = free_minimum(qp, make_workspace(qp), z)
    mark_violated(qp, z, 0.0, broken)
    return residual, z, broken


@settings(deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.3, 100.0]))
def test_the_free_minimum_is_taken_only_where_it_solves_the_qp(seed: int, bound: float) -> None:
    qp = random_qp(seed, bound)
    free = -np.linalg.solve(qp.hessian, qp.gradient)
    residual, z, broken = without_rows(qp)
    np.testing.assert_allclose(z, free, atol=1e-9)
    np.testing.assert_array_equal(broken, np.abs(qp.matrix @ free) > bound)
    answer = QPSolver(1e-6, 100, 1e-6).solve(qp)
    assert answer.status is SolveStatus.OPTIMAL
    assert answer.residual < 1e-6
    if not broken.any():
        multipliers = np.zeros(6)
        exact = kkt_residual(qp, z, multipliers)
        assert residual == pytest.approx(exact, abs=1e-12)
        np.testing.assert_array_equal(answer.z, z)


@settings(deadline=None)
@given(st.lists(st.integers(0, 10_000), min_size=1, max_size=4), st.sampled_from([0.01, 0.1, 0.3]))
def test_few_rows_give_the_answer_of_all_rows(seeds: list[int], bound: float) -> None:
    """Also from the rows that were active in another problem, and after a reset as from the beginning."""
    solver = QPSolver(1e-6, 100, 1e-6)
    for qp in (random_qp(seed, bound) for seed in seeds):
        answer = solver.solve(qp)
        z, _, flag, _ = daqp.solve(qp.hessian, qp.gradient, qp.matrix, qp.upper, qp.lower, np.zeros(6, dtype=np.int32))
        assert flag == 1
        assert answer.status is SolveStatus.OPTIMAL
        assert answer.residual < 1e-9
        np.testing.assert_allclose(answer.z, z, atol=1e-7)
    last = random_qp(seeds[-1], bound)
    solver.reset()
    np.testing.assert_array_equal(solver.solve(last).z, QPSolver(1e-6, 100, 1e-6).solve(last).z)


def test_few_rows_need_no_general_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that the free minimum breaks, then those that the answer breaks; on the next tick all of them at once."""
    solver, rounds = QPSolver(1e-6, 100, 1e-6), []
    monkeypatch.setattr("controllers.qp.solve.daqp.solve", None)
    qp = QP(  # about (3, 0.9): that breaks z_0 <= 1, and (1, 0.9) breaks 2 z_1 - z_0 <= 0.2; the rest is far away
        np.eye(2),
        np.array([-3.0, -0.9]),
        np.array([[1.0, 0.0], [-1.0, 2.0], [0.0, 1.0], [1.0, -9.0], [0.3, 0.3]]),
        np.full(5, -20.0),
        np.array([1.0, 0.2, 20.0, 20.0, 20.0]),
        np.zeros(5, dtype=bool),
    )
    for upper in (1.0, 0.9, 50.0):
        qp.upper[0] = upper
        answer = solver.solve(qp)
        rounds.append(answer.status)
        expected = [min(upper, 1.6), 0.5 * (0.2 + min(upper, 1.6))] if upper < 3.0 else answer.z
        np.testing.assert_allclose(answer.z, expected, atol=1e-12)
        assert answer.residual < 1e-14
    assert rounds == [SolveStatus.OPTIMAL] * 3


def test_many_rows_are_left_to_a_general_solver() -> None:
    count = MARKED_MAX + 6
    qp = QP(
        np.eye(count),
        np.full(count, -3.0),
        np.vstack([np.eye(count), np.ones((1, count))]),
        np.full(count + 1, -100.0),
        np.array([*np.full(count, 1.0), 100.0]),
        np.zeros(count + 1, dtype=bool),
    )
    answer = QPSolver(1e-6, 100, 1e-6).solve(qp)
    assert answer.status is SolveStatus.OPTIMAL
    np.testing.assert_allclose(answer.z, 1.0, atol=1e-9)


def test_dependent_rows_are_left_to_a_general_solver() -> None:
    """Three rows through one point of the plane, two of them enough."""
    qp = QP(
        np.eye(2),
        np.array([-3.0, -3.0]),
        np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]),
        np.full(3, -100.0),
        np.array([1.0, 2.0, 3.0]),
        np.zeros(3, dtype=bool),
    )
    answer = QPSolver(1e-6, 100, 1e-6).solve(qp)
    assert answer.status is SolveStatus.OPTIMAL
    np.testing.assert_allclose(answer.z, [1.0, 1.0], atol=1e-9)


def test_the_free_minimum_needs_a_positive_definite_cost() -> None:
    qp = random_qp(3, 100.0)
    qp.hessian[:] = -np.eye(5)
    assert np.isnan(without_rows(qp)[0])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["hessian", "gradient", "matrix"])
def test_one_bad_number_is_seen(where: str, value: float) -> None:
    qp = random_qp(0, 1.0)
    assert all_finite(qp)
    getattr(qp, where).flat[-1] = value
    assert not all_finite(qp)
    assert QPSolver(1e-6, 100, 1e-6).solve(qp).status is SolveStatus.HELD
