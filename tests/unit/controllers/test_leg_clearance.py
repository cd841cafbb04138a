"""Legs that are kept apart: the rows of the limit, and a swing foot that is led into the other leg."""

from dataclasses import replace as replaced

import numpy as np
import pinocchio as pin
import pytest
from msgspec.structs import replace

from controllers.qp.terms import Terms
from controllers.whole_body.config import load_whole_body_config
from controllers.whole_body.controller import WholeBodyController
from controllers.whole_body.leg_clearance import LegClearanceLimit
from controllers.whole_body.limits import UNBOUNDED
from models.leg_shapes import foot_size, leg_chains, leg_shapes
from models.robot_model import RobotModel
from models.types import Reference, RobotState, SolveStatus
from tests.support import standing

ROBOTS = ("g1", "talos")
DT = 0.001
SCALE = 0.01  #: Of the limit's rows


@pytest.fixture(scope="module", params=ROBOTS)
def model(request: pytest.FixtureRequest) -> RobotModel:
    return RobotModel.load(request.param)


class Legs:
    """Distances of the legs' hulls, all measured."""

    def __init__(self, model: RobotModel) -> None:
        self.model, self.data, self.shapes = model.pin, model.data(), leg_shapes(model, hulls=True)
        self.found = self.shapes.createData()
        self.kept = self.at(model.standing_configuration()) > 0.01

    def at(self, q: np.ndarray) -> np.ndarray:
        pin.updateGeometryPlacements(self.model, self.data, self.shapes, self.found, q)
        count = len(self.shapes.collisionPairs)
        return np.array([pin.computeDistance(self.shapes, self.found, k).min_distance for k in range(count)])


def with_legs_close(model: RobotModel, legs: Legs, seed: int) -> RobotState:
    """A state with at least one pair that is kept apart between 5 and 40 mm."""
    rng, joints = np.random.default_rng(seed), [joint for leg in leg_chains(model) for joint in leg]
    columns = [model.pin.idx_qs[joint] for joint in joints]
    while True:
        q = model.standing_configuration().copy()
        q[columns] += 0.35 * rng.normal(size=len(columns))
        if 0.005 < legs.at(q)[legs.kept].min() < 0.04:
            return standing(model, q=q, v=rng.normal(size=model.nv))


def some_reference(model: RobotModel, terms: Terms) -> Reference:
    """The robot on its right foot, as it is."""
    soles, still = terms.soles, np.zeros(3)
    return Reference(
        com=terms.com.copy(),
        com_velocity=still,
        com_acceleration=still,
        base_orientation=terms.frames["base_link"].rotation.copy(),
        torso_orientation=terms.torso.rotation.copy(),
        posture=model.posture("stand"),
        posture_velocity=np.zeros(model.nj),
        posture_acceleration=np.zeros(model.nj),
        sole_rotations=np.array([sole.rotation for sole in soles]),
        sole_positions=np.array([sole.position for sole in soles]),
        sole_velocities=np.zeros((2, 6)),
        sole_accelerations=np.zeros((2, 6)),
        contacts=(False, True),
        load=(0.0, 1.0),
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_row_is_the_derivative_of_a_distance(model: RobotModel, seed: int) -> None:
    """Along the velocity, by differences; its bound is that of the law."""
    legs, config = Legs(model), load_whole_body_config(model).limits.legs
    limit, terms = LegClearanceLimit(model, config), Terms(model)
    state, h = with_legs_close(model, legs, seed), 1e-4  # GJK finds distances to 1e-6 m
    terms.update(state)
    for _ in range(4 * len(legs.kept)):  # three pairs a look, at least every fourth tick, until all have been measured
        limit.bound(terms, some_reference(model, terms))
    here = np.sort(legs.at(state.q)[legs.kept])
    order = np.argsort(legs.at(state.q) + np.where(legs.kept, 0.0, np.inf))
    later, earlier = (legs.at(pin.integrate(model.pin, state.q, sign * h * state.v)) for sign in (1.0, -1.0))
    rates = ((later - earlier) / (2.0 * h))[order]
    used = int((here[: len(limit.lower)] < config.reach).sum())
    assert used > 0
    np.testing.assert_allclose(limit.matrix[:used] @ state.v / SCALE, rates[:used], atol=0.02)
    wanted = config.velocity_gain * (config.position_gain * (config.gap - here[:used]) - rates[:used])
    bound = np.clip(wanted, -config.acceleration, config.acceleration)
    np.testing.assert_allclose(limit.lower[:used] / SCALE, bound, atol=1.0)
    assert (limit.lower[used:] == -UNBOUNDED).all()
    limit.bound(terms, replace(some_reference(model, terms), contacts=(True, True)))
    assert (limit.lower == -UNBOUNDED).all()


def test_a_near_pair_has_its_row_in_every_tick_of_a_fast_motion(model: RobotModel) -> None:
    """Even where any other pair may have come nearer since it was measured."""
    legs, config = Legs(model), load_whole_body_config(model).limits.legs
    limit, terms, state = LegClearanceLimit(model, config), Terms(model), with_legs_close(model, legs, 4)
    terms.update(state)
    for _ in range(4 * len(legs.kept)):
        limit.bound(terms, some_reference(model, terms))
    joints, near = [model.pin.idx_qs[joint] for leg in leg_chains(model) for joint in leg], 0
    for tick in range(60):
        q = state.q.copy()
        q[joints] += 0.03 * np.sin(0.5 * tick + np.arange(len(joints)))
        terms.update(replace(state, q=q))
        limit.bound(terms, some_reference(model, terms))
        if (nearest := legs.at(q)[legs.kept].min()) < 0.5 * config.reach:
            near += 1
            assert limit.lower[0] > -UNBOUNDED, (tick, nearest)
    assert near > 20


@pytest.mark.parametrize("enabled", [True, False])
def test_a_foot_that_is_led_into_the_other_leg_stops_before_it(model: RobotModel, enabled: bool) -> None:
    legs, config = Legs(model), load_whole_body_config(model)
    config = replaced(config, limits=replaced(config.limits, legs=replaced(config.limits.legs, enabled=enabled)))
    controller = WholeBodyController(model, config)
    state = standing(model, q=model.standing_configuration().copy(), v=np.zeros(model.nv))
    controller.terms.update(state)
    reference, width = some_reference(model, controller.terms), foot_size(model)[1]
    start, nearest = reference.sole_positions[0].copy(), np.inf
    for tick in range(300):
        share = min(tick / 200.0, 1.0)
        place = start + np.array([0.0, -2.0 * share * start[1], 0.02 * min(tick / 50.0, 1.0)])
        reference = replace(reference, sole_positions=np.array([place, reference.sole_positions[1]]))
        controller.terms.update(state)
        _, status = controller.step(state, reference)
        assert status in (SolveStatus.OPTIMAL, SolveStatus.RELAXED)
        q = pin.integrate(model.pin, state.q, DT * state.v + 0.5 * DT**2 * controller.acceleration)
        state = replace(state, q=q, v=state.v + DT * controller.acceleration)
        if tick % 10 == 0:
            nearest = min(nearest, legs.at(q)[legs.kept].min())
    controller.terms.update(state)
    apart = controller.terms.soles[0].position[1] - controller.terms.soles[1].position[1]
    if enabled:
        assert nearest > 0.0
        assert 0.8 * width < apart < 2.0 * start[1]
    else:
        assert nearest < 0.0
