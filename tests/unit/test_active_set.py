"""The compiled active-set solver against quadprog, on random problems with dependent rows and equalities."""

from __future__ import annotations

import numpy as np
import pytest
import quadprog
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.qp.kernels_active_set import active_set
from controllers.qp.kernels_cholesky import factorise, solve_lower, solve_upper

NZ, SIMPLE = 6, 2

Problem = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def random_problem(seed: int, bound: float, *, equal: bool = False) -> Problem:
    """Two simple rows and nine general ones; the last three general ones are sums of others. z = 0 is inside."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(NZ, NZ))
    independent = rng.normal(size=(6, NZ))
    matrix = np.vstack([independent, independent[:3] + independent[3:]])
    upper = bound * rng.uniform(0.1, 1.0, SIMPLE + 9)
    lower = -bound * rng.uniform(0.1, 1.0, SIMPLE + 9)
    if equal:
        lower[3] = upper[3] = 0.0
    return root.T @ root + 0.1 * np.eye(NZ), 3.0 * rng.normal(size=NZ), matrix, lower, upper


def solve(problem: Problem, iterations: int = 100) -> tuple[np.ndarray, float]:
    factor, z = np.empty((NZ, NZ)), np.empty(NZ)
    assert factorise(problem[0], NZ, factor)
    return z, active_set(*problem, factor, iterations, z)


def reference(problem: Problem) -> np.ndarray:
    hessian, gradient, matrix, lower, upper = problem
    rows = np.vstack([np.eye(NZ)[:SIMPLE], matrix])
    equal, free = lower == upper, lower != upper
    rows = np.vstack([rows[equal], rows[free], -rows[free]])
    bounds = np.concatenate([lower[equal], lower[free], -upper[free]])
    answer: np.ndarray = quadprog.solve_qp(hessian, -gradient, rows.T, bounds, int(np.count_nonzero(equal)))[0]
    return answer


@settings(deadline=None, max_examples=300)
@given(st.integers(0, 100_000), st.sampled_from([0.01, 0.3, 2.0, 100.0]), st.booleans())
def test_it_finds_quadprogs_optimum(seed: int, bound: float, equal: bool) -> None:
    problem = random_problem(seed, bound, equal=equal)
    z, residual = solve(problem)
    assert residual < 1e-9
    np.testing.assert_allclose(z, reference(problem), atol=1e-7)


def test_many_rows_are_active_and_some_are_dropped() -> None:
    """More changes than active rows: some that were added had to leave again."""
    problem = random_problem(4, 0.01)
    z, residual = solve(problem)
    values = np.concatenate([z[:SIMPLE], problem[2] @ z])
    active = int(np.count_nonzero(np.minimum(values - problem[3], problem[4] - values) < 1e-9))
    assert residual < 1e-9 and active >= 4
    most = next(limit for limit in range(1, 100) if np.isfinite(solve(problem, limit)[1]))
    assert most > active + 1


@pytest.mark.parametrize("broken", ["parallel", "combined"])
def test_an_infeasible_problem_is_told(broken: str) -> None:
    hessian, gradient, matrix, lower, upper = random_problem(1, 1.0)
    if broken == "parallel":
        matrix[1], lower[SIMPLE + 1], upper[SIMPLE + 1] = matrix[0], upper[SIMPLE] + 1.0, upper[SIMPLE] + 2.0
    else:  # the last row is the sum of two others
        lower[-1] = upper[SIMPLE + 2] + upper[SIMPLE + 5] + 0.1
        upper[-1] = lower[-1] + 1.0
    assert solve((hessian, gradient, matrix, lower, upper))[1] == np.inf


def test_too_few_iterations_are_told() -> None:
    problem = random_problem(4, 0.01)
    assert solve(problem, 2)[1] == np.inf
    assert solve(problem, 100)[1] < 1e-9


def test_numbers_that_are_not_finite_are_no_answer() -> None:
    problem = random_problem(1, 1.0)
    problem[1][0] = np.nan
    assert not solve(problem)[1] < 1e-6


@given(st.integers(0, 100_000), st.integers(1, NZ))
@settings(deadline=None)
def test_the_factor_solves_the_leading_block(seed: int, size: int) -> None:
    matrix, vector, *_ = random_problem(seed, 1.0)
    factor, solution = np.empty((NZ, NZ)), vector.copy()
    assert factorise(matrix, size, factor)
    solve_lower(factor, size, solution)
    solve_upper(factor, size, solution)
    np.testing.assert_allclose(matrix[:size, :size] @ solution[:size], vector[:size], atol=1e-8)
    np.testing.assert_array_equal(solution[size:], vector[size:])
    assert not factorise(-matrix, size, factor)
