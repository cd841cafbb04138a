"""A QP whose minimum without rows keeps all limits is solved without its rows, and to the same bit as with them."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.whole_body import WholeBodyController
from models.robot_model import RobotModel
from models.types import SolveStatus
from tests.support import standing
from tests.unit.test_whole_body_qp import CONTACTS, prepare


@pytest.fixture(scope="module", params=["g1", "talos"])
def model(request: pytest.FixtureRequest) -> RobotModel:
    return RobotModel.load(request.param)


def breaks(controller: WholeBodyController, z: np.ndarray) -> tuple[bool, float]:
    """Whether a point breaks a row of the assembled problem, and how near the nearest bound is."""
    qp = controller.problem
    assert qp is not None
    values = np.concatenate([z[: len(qp.lower) - len(qp.matrix)], qp.matrix @ z])
    slack = np.minimum(values - qp.lower, qp.upper - values)
    return bool(slack.min() < 0.0), float(np.abs(slack).min())


@pytest.mark.parametrize("contacts", CONTACTS)
def test_a_point_keeps_the_limits_just_when_it_breaks_no_row(model: RobotModel, contacts: tuple[bool, bool]) -> None:
    state, rng = standing(model), np.random.default_rng(1)
    controller, reference = prepare(model, state, contacts)
    answers = []
    for _ in range(60):
        qp = controller.builder.build(controller.terms, reference, controller.limits)
        assert qp.keeps is not None and controller.solution.z is not None
        away = rng.normal(size=len(qp.gradient)) * 10.0 ** rng.uniform(-4.0, 3.0)
        z = controller.solution.z + away
        keeps = qp.keeps(z)
        controller._problem = qp
        broken, near = breaks(controller, z)
        if near > 1e-9:
            assert keeps != broken
            answers.append(keeps)
    assert 5 < sum(answers) < len(answers) - 5  # both kinds were met


def test_rows_are_filled_only_where_they_are_needed(model: RobotModel) -> None:
    state = standing(model)
    controller, reference = prepare(model, state, (True, True))
    assert controller._problem is not None and controller._problem.complete is not None  # solved without them
    without = controller.step(state, reference)[0]
    (work,) = (work for work in controller.solver._workspaces.values() if work.arrays[1].size > 1)
    work.held = True  # as if the last tick had held a row
    with_rows = controller.step(state, reference)[0]
    assert controller._problem.complete is None and not work.held
    for name in ("q", "v", "tau"):
        np.testing.assert_array_equal(getattr(without, name), getattr(with_rows, name))


@pytest.mark.parametrize("where", ["bias", "mass_matrix"])
def test_a_term_that_is_no_number_is_seen_without_rows(model: RobotModel, where: str) -> None:
    controller, reference = prepare(model, standing(model), (True, True))
    getattr(controller.terms, where)[-1] = np.nan
    qp = controller.builder.build(controller.terms, reference, controller.limits)
    assert controller.solver.solve(qp).status is SolveStatus.HELD
