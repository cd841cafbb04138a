"""Kernels that replace library calls in the tick, held to those calls."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.memory import Block, part_1, part_2, part_3
from controllers.posture_reference import PostureReference
from controllers.qp.build import QP
from controllers.qp.kernels_check import all_finite, free_minimum, kkt_residual
from controllers.qp.kernels_reduce import solve_base
from controllers.qp.solve import QPSolver
from models.robot_model import RobotModel
from models.types import SolveStatus


def test_parts_of_a_block_are_its_memory() -> None:
    block = Block({"a": (2,), "b": (2, 3), "c": (2, 3, 4)})
    block["a"][:], block["b"][:], block["c"][:] = 1.0, np.arange(6).reshape(2, 3), 3.0
    np.testing.assert_array_equal(part_1(block.data, block.layout, 0), [1.0, 1.0])
    np.testing.assert_array_equal(part_2(block.data, block.layout, 1), block["b"])
    part_3(block.data, block.layout, 2)[1, 2, 3] = 9.0
    assert block["c"][1, 2, 3] == 9.0
    assert block.data.size == 2 + 6 + 24


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_posture_reference_equals_pinocchio(robot: str) -> None:
    model = RobotModel.load(robot)
    posture, data, rng = PostureReference(model), model.data(), np.random.default_rng(1)
    for k in range(10):
        joints = rng.uniform(model.q_lower, model.q_upper) if k else model.posture("stand")
        posture.update(joints)
        q = pin.neutral(model.pin)
        q[7:] = joints
        com = pin.centerOfMass(model.pin, data, q)
        pin.framesForwardKinematics(model.pin, data, q)
        left, right = (data.oMf[foot.frame_id] for foot in model.feet)
        middle = left.rotation @ pin.exp3(0.5 * pin.log3(left.rotation.T @ right.rotation))
        torso = data.oMf[model.frame_id("torso")].rotation
        np.testing.assert_allclose(posture.base, middle.T, atol=1e-10)
        np.testing.assert_allclose(posture.torso, middle.T @ torso, atol=1e-10)
        centre = 0.5 * (left.translation + right.translation)
        np.testing.assert_allclose(posture.com, middle.T @ (com - centre), atol=1e-10)


def random_qp(seed: int, bound: float) -> QP:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(7, 5))
    return QP(
        root.T @ root + 0.1 * np.eye(5),
        rng.normal(size=5),
        rng.normal(size=(4, 5)),
        np.full(6, -bound),
        np.full(6, bound),
        np.zeros(6, dtype=bool),
    )


@settings(deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.3, 100.0]))
def test_the_free_minimum_is_taken_only_where_it_solves_the_qp(seed: int, bound: float) -> None:
    qp = random_qp(seed, bound)
    z, free = np.empty(5), -np.linalg.solve(qp.hessian, qp.gradient)
    residual = free_minimum(qp.hessian, qp.gradient, qp.matrix, qp.lower, qp.upper, z)
    np.testing.assert_allclose(z, free, atol=1e-9)
    values = np.concatenate([free[:2], qp.matrix @ free])
    assert np.isfinite(residual) == bool((np.abs(values) <= bound).all())
    answer = QPSolver(1e-6, 100, 1e-6).solve(qp)
    assert answer.status is SolveStatus.OPTIMAL
    assert answer.residual < 1e-6
    if np.isfinite(residual):
        multipliers = np.zeros(6)
        exact = kkt_residual(qp.hessian, qp.gradient, qp.matrix, qp.lower, qp.upper, z, multipliers)
        assert residual == pytest.approx(exact, abs=1e-12)
        np.testing.assert_array_equal(answer.z, z)


def test_the_free_minimum_needs_a_positive_definite_cost() -> None:
    qp = random_qp(3, 100.0)
    qp.hessian[:] = -np.eye(5)
    assert free_minimum(qp.hessian, qp.gradient, qp.matrix, qp.lower, qp.upper, np.empty(5)) == np.inf


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["hessian", "gradient", "matrix"])
def test_one_bad_number_is_seen(where: str, value: float) -> None:
    qp = random_qp(0, 1.0)
    assert all_finite(qp.hessian, qp.gradient, qp.matrix)
    getattr(qp, where).flat[-1] = value
    assert not all_finite(qp.hessian, qp.gradient, qp.matrix)


def test_solve_base_inverts_the_base_block() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(8, 8))
    mass, right = root @ root.T + np.eye(8), rng.normal(size=(6, 3))
    expected = np.linalg.solve(mass[:6, :6], right)
    solve_base(mass, right)
    np.testing.assert_allclose(right, expected, atol=1e-10)
