"""The step adjustment: optimal, undisturbed where nothing disturbs, inside its bounds."""

import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import minimize

from models.config import default_config
from planners.gait.config import GaitConfig
from planners.gait.foot_motion import FootLimits, reachable_distance, time_to_pass, time_to_rest
from planners.gait.regions import arrival
from planners.gait.step_problem import UNSOLVED, StepProblem, best_step, weights_of

CONFIG = default_config(GaitConfig, "planners", "gait").adjustment
OMEGA, ELAPSED = 3.85, 0.1
NOMINAL = StepProblem(
    dcm=np.zeros(2),
    elapsed=ELAPSED,
    omega=OMEGA,
    step=np.array([0.15, 0.2]),
    time=0.34,
    offset=np.array([0.03, -0.045]),
    coupling=0.0,
    lower=np.array([-0.3, 0.12]),
    upper=np.array([0.45, 0.45]),
    soonest=0.2,
    latest=0.6,
    cop=np.array([0.04, 0.012]),
    kept=False,
    place=np.zeros(2),
    velocities=np.zeros((2, 2)),
    leaves=ELAPSED,
    foot_limits=FootLimits(100.0, 1e4),  # bounds nothing
)


def undisturbed() -> np.ndarray:
    """DCM that arrives at the nominal step's DCM at the nominal time with the CoP in the middle."""
    return (NOMINAL.step + NOMINAL.offset) * math.exp(-OMEGA * (NOMINAL.time - ELAPSED))


class Step(NamedTuple):
    """A solution; lengths (2,) [m]."""

    step: np.ndarray
    time: float
    offset: np.ndarray
    cop: np.ndarray
    solved: bool


def solve(dcm: np.ndarray, *, ending: bool = False, **changed: Any) -> Step:
    problem, z = NOMINAL._replace(dcm=dcm, **changed), np.empty(5)
    value = best_step(problem, weights_of(CONFIG)[ending], z)
    growth = math.exp(-OMEGA * ELAPSED) * z[2]
    offset = growth * dcm - (growth - 1.0) * z[3:] - z[:2]
    return Step(z[:2], math.log(z[2]) / OMEGA, offset, z[3:], value < UNSOLVED)


def cost(z: np.ndarray, dcm: np.ndarray, ending: bool) -> float:
    """The objective written out, in the variables (u, tau, delta)."""
    growth = math.exp(-OMEGA * ELAPSED) * z[2]
    offset = growth * dcm - (growth - 1.0) * z[3:] - z[:2]
    return float(
        CONFIG.position * np.sum((z[:2] - NOMINAL.step) ** 2)
        + (CONFIG.time_ending if ending else CONFIG.time) * (z[2] - math.exp(OMEGA * NOMINAL.time)) ** 2
        + CONFIG.offset * np.sum((offset - NOMINAL.offset) ** 2)
        + CONFIG.cop * np.sum(z[3:] ** 2)
    )


def test_an_undisturbed_step_is_the_nominal_one() -> None:
    step = solve(undisturbed())
    assert step.solved
    assert step.step == pytest.approx(NOMINAL.step, abs=1e-6)
    assert step.time == pytest.approx(NOMINAL.time, abs=1e-6)
    assert step.offset == pytest.approx(NOMINAL.offset, abs=1e-6)
    assert step.cop == pytest.approx(np.zeros(2), abs=1e-6)


@pytest.mark.parametrize("error", [(0.01, 0.0), (-0.02, 0.01), (0.05, 0.03), (0.0, -0.02), (0.2, 0.1), (-0.2, -0.2)])
@pytest.mark.parametrize("ending", [False, True])
def test_it_is_the_minimum_inside_the_bounds(error: tuple[float, float], ending: bool) -> None:
    dcm = undisturbed() + error
    step = solve(dcm, ending=ending)
    z = np.array([*step.step, math.exp(OMEGA * step.time), *step.cop])
    lower = np.array([*NOMINAL.lower, math.exp(OMEGA * NOMINAL.soonest), *(-NOMINAL.cop)])
    upper = np.array([*NOMINAL.upper, math.exp(OMEGA * NOMINAL.latest), *NOMINAL.cop])
    assert (z >= lower - 1e-7).all() and (z <= upper + 1e-7).all()
    # KKT: the gradient vanishes inside, and points outwards of the bound where one is active.
    h = 1e-6
    gradient = np.array([(cost(z + h * e, dcm, ending) - cost(z - h * e, dcm, ending)) / (2.0 * h) for e in np.eye(5)])
    scale = 1.0 + np.abs(gradient).max()
    for value, low, high, slope in zip(z, lower, upper, gradient, strict=True):
        if value <= low + 1e-7:
            assert slope >= -1e-4 * scale
        elif value >= high - 1e-7:
            assert slope <= 1e-4 * scale
        else:
            assert abs(slope) < 1e-4 * scale
    start = np.clip(np.array([*NOMINAL.step, math.exp(OMEGA * NOMINAL.time), 0.0, 0.0]), lower, upper)
    other = minimize(cost, start, args=(dcm, ending), bounds=list(zip(lower, upper, strict=True)), method="L-BFGS-B")
    assert cost(z, dcm, ending) <= other.fun + 1e-6


def test_a_push_moves_the_foot_along() -> None:
    ahead = solve(undisturbed() + np.array([0.06, 0.0]))
    aside = solve(undisturbed() + np.array([0.0, 0.03]))
    assert ahead.step[0] > NOMINAL.step[0] + 0.03
    assert aside.step[1] > NOMINAL.step[1] + 0.02
    assert ahead.offset == pytest.approx(NOMINAL.offset, abs=0.01)


def test_a_push_against_the_swing_foot_lands_it_sooner_or_nearer() -> None:
    inward = solve(undisturbed() + np.array([0.0, -0.02]))
    assert inward.step[1] >= NOMINAL.lower[1] - 1e-9
    assert inward.step[1] < NOMINAL.step[1]


def test_the_offset_follows_the_foothold() -> None:
    """A step that comes out longer is to end at another offset."""
    dcm, coupling = undisturbed() + np.array([0.04, 0.0]), -0.2
    step = solve(dcm, coupling=coupling)
    longer = step.step - NOMINAL.step
    assert longer[0] > 0.03
    assert step.offset == pytest.approx(NOMINAL.offset + coupling * longer, abs=1e-3)


@pytest.mark.parametrize("leaves", [ELAPSED, ELAPSED + 0.05])
def test_a_foot_that_is_to_land_farther_does_so_later(leaves: float) -> None:
    """The way that is left at the foot's speed bounds the foothold, and grows with the time of the step.

    Also that from a corner, which the foot reaches later.
    """
    place, foot_limits = np.array([0.0, 0.2]), FootLimits(1.2, 1e4)
    dcm = undisturbed() + np.array([0.2, 0.0])
    step, free = solve(dcm, place=place, leaves=leaves, foot_limits=foot_limits), solve(dcm)
    assert step.solved
    assert np.abs(step.step - place).max() <= foot_limits.speed * (step.time - leaves) + 1e-9
    # The bound is active: without it the foot goes farther.
    assert free.step[0] - place[0] > foot_limits.speed * (free.time - leaves)


@pytest.mark.parametrize("velocity", [-1.5, 0.0, 0.6, 2.0])
def test_the_way_that_a_foot_gets_is_that_of_largest_acceleration_and_braking(velocity: float) -> None:
    """Against a search over the moment at which it begins to brake; the derivative against differences."""
    foot_limits, time, h = FootLimits(1e3, 50.0), 0.15, 1e-6
    way, rate = reachable_distance(time, velocity, foot_limits)

    def ending(switch: float) -> tuple[float, float]:
        top = velocity + 50.0 * switch
        braked = time - switch
        return velocity * switch + 25.0 * switch**2 + top * braked - 25.0 * braked**2, top - 50.0 * braked

    switches = np.linspace(0.0, time, 100001)
    at_rest = min(switches, key=lambda switch: abs(ending(switch)[1]))
    assert way == pytest.approx(ending(at_rest)[0], abs=1e-4)
    later, earlier = (reachable_distance(time + sign * h, velocity, foot_limits)[0] for sign in (1.0, -1.0))
    assert rate == pytest.approx((later - earlier) / (2.0 * h), rel=1e-4)
    assert reachable_distance(time, velocity, FootLimits(0.1, 50.0))[0] <= 0.1 * time + 1e-12


@pytest.mark.parametrize(("way", "velocity"), [(0.2, 0.0), (0.2, 1.0), (0.2, -1.0), (-0.2, 1.0)])
def test_the_time_to_a_corner_is_that_of_largest_acceleration(way: float, velocity: float) -> None:
    foot_limits, towards = FootLimits(1e3, 50.0), math.copysign(1.0, way)
    time, rests = time_to_pass(way, velocity, foot_limits), time_to_rest(way, velocity, foot_limits)
    assert velocity * time + towards * 25.0 * time**2 == pytest.approx(way, abs=1e-9)
    assert reachable_distance(rests, towards * velocity, foot_limits)[0] == pytest.approx(abs(way))
    assert time_to_pass(way, velocity, FootLimits(0.1, 50.0)) >= abs(way) / 0.1


def test_a_foot_comes_to_rest_at_a_corner_along_the_axis_that_it_blocks() -> None:
    """Ahead when it crosses, aside on its way back; mirrored for the other foot."""
    foot_limits, still = FootLimits(1e3, 50.0), (0.0, 0.0)
    time, (x, y) = arrival((-0.1, 0.2), still, (0.2, 0.1), foot_limits)
    assert time == pytest.approx(time_to_rest(0.3, 0.0, foot_limits)) and x == 0.0
    assert y == pytest.approx(-50.0 * time_to_pass(0.1, 0.0, foot_limits))
    time, (x, y) = arrival((0.25, -0.05), still, (0.2, 0.1), foot_limits)
    assert time == pytest.approx(time_to_rest(0.15, 0.0, foot_limits)) and y == 0.0 and x < 0.0
    mirrored = arrival((0.25, 0.05), still, (0.2, -0.1), foot_limits)
    assert mirrored == (pytest.approx(time), (pytest.approx(x), 0.0))
    for side in (1.0, -1.0):  # inside already: it leaves ahead, and keeps its velocity across
        time, (x, y) = arrival((0.1, side * 0.05), (0.0, -1.5 * side), (0.23, side * 0.05), foot_limits)
        assert (x, y) == (0.0, -1.5 * side) and time == pytest.approx(time_to_rest(0.13, 0.0, foot_limits))


def test_a_foot_under_way_lands_less_far_behind_it() -> None:
    """What it has to brake first it cannot go the other way; in its own region there is always a foothold."""
    place, pushed, forward = np.array([0.0, 0.2]), undisturbed() + np.array([-0.15, 0.0]), np.array([[1.5], [0.0]])
    slow = {"place": place, "foot_limits": FootLimits(3.0, 20.0), "soonest": 0.34, "latest": 0.34}
    still, moving = solve(pushed, **slow), solve(pushed, velocities=forward * np.ones(2), **slow)
    assert still.solved and moving.solved
    assert moving.step[0] > still.step[0] + 0.02
    fast = {**slow, "velocities": 4.0 * forward * np.ones(2)}  # comes to rest beyond the largest foothold
    assert not solve(pushed, **fast).solved
    kept = solve(pushed, kept=True, **fast)
    assert kept.solved and kept.step[0] == pytest.approx(NOMINAL.upper[0])


def test_without_a_solution_it_keeps_to_the_nominal_step() -> None:
    """A foot that is too far away and hardly moves, or a DCM that is not a number."""
    stuck = {"place": np.array([5.0, 5.0]), "foot_limits": FootLimits(0.1, 1e4)}
    for dcm, changed in ((undisturbed(), stuck), (np.full(2, np.nan), {})):
        step = solve(dcm, **changed)
        assert not step.solved
        assert step.step == pytest.approx(NOMINAL.step)
        assert step.time == pytest.approx(NOMINAL.time)
