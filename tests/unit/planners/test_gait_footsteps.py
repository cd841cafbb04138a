"""Footholds from a velocity: no crossing, inside the reach, mirrored, and as fast as commanded."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.config import default_config
from planners.gait.commands import approached, limited
from planners.gait.config import GaitConfig
from planners.gait.footsteps import LEFT, RIGHT, Foothold, clamped, limits_of, next_foothold, preview_footholds, wrap

GAIT = default_config(GaitConfig, "planners", "gait")
REACH = GAIT.reach
PERIOD = 0.45

velocities = st.tuples(st.floats(-1.0, 1.5), st.floats(-0.8, 0.8), st.floats(-2.0, 2.0))
poses = st.builds(Foothold, st.floats(-5, 5), st.floats(-5, 5), st.floats(-math.pi, math.pi))


@settings(max_examples=200, deadline=None)
@given(stance=poses, foot=st.sampled_from([LEFT, RIGHT]), velocity=velocities)
def test_steps_stay_in_reach_and_never_cross(stance: Foothold, foot: int, velocity: tuple[float, float, float]) -> None:
    step = next_foothold(stance, foot, velocity, PERIOD, REACH)
    side = 1.0 if foot == LEFT else -1.0
    forward, left = stance.relative(step.x, step.y)
    assert -REACH.backward - 1e-9 <= forward <= REACH.forward + 1e-9
    assert REACH.width_min - 1e-9 <= side * left <= REACH.width_max + 1e-9
    turn = side * wrap(step.yaw - stance.yaw)
    assert -REACH.turn_in - 1e-9 <= turn <= REACH.turn_out + 1e-9


@settings(max_examples=100, deadline=None)
@given(foot=st.sampled_from([LEFT, RIGHT]), velocity=velocities)
def test_a_mirrored_command_gives_the_mirrored_step(foot: int, velocity: tuple[float, float, float]) -> None:
    origin = Foothold(0.0, 0.0, 0.0)
    step = next_foothold(origin, foot, velocity, PERIOD, REACH)
    mirrored = next_foothold(origin, 1 - foot, (velocity[0], -velocity[1], -velocity[2]), PERIOD, REACH)
    assert mirrored.x == pytest.approx(step.x, abs=1e-12)
    assert mirrored.y == pytest.approx(-step.y, abs=1e-12)
    assert mirrored.yaw == pytest.approx(-step.yaw, abs=1e-12)


@pytest.mark.parametrize(
    "velocity", [(0.3, 0.0, 0.0), (-0.2, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, -0.2, 0.0), (0.2, 0.1, 0.0)]
)
def test_two_steps_move_as_far_as_commanded(velocity: tuple[float, float, float]) -> None:
    start = Foothold(0.0, -0.5 * REACH.width, 0.0)
    steps = preview_footholds(start, LEFT, velocity, PERIOD, REACH, 8)
    # From the right foot to the right foot, after the first pair has taken its rhythm.
    moved = (steps[7].x - steps[1].x, steps[7].y - steps[1].y)
    assert moved[0] == pytest.approx(6 * PERIOD * velocity[0], abs=1e-9)
    assert moved[1] == pytest.approx(6 * PERIOD * velocity[1], abs=1e-9)


@pytest.mark.parametrize("rate", [0.3, -0.3, 0.8, -0.8])
def test_turning_in_place_turns_as_commanded_and_stays(rate: float) -> None:
    stance = Foothold(0.0, -0.5 * REACH.width, 0.0)
    steps = preview_footholds(stance, LEFT, (0.0, 0.0, rate), PERIOD, REACH, 10)
    assert wrap(steps[9].yaw - steps[1].yaw) == pytest.approx(wrap(8 * PERIOD * rate), abs=1e-9)
    middles = [(0.5 * (a.x + b.x), 0.5 * (a.y + b.y)) for a, b in zip(steps[1:], steps[:-1], strict=True)]
    assert max(math.hypot(*middle) for middle in middles) < 0.04


def test_stopping_ends_with_the_feet_side_by_side() -> None:
    stance = Foothold(1.0, 2.0, 0.7)
    steps = preview_footholds(stance, LEFT, (0.5, 0.1, 0.4), PERIOD, REACH, 4, stop_after=2)
    assert len(steps) == 2
    forward, left = steps[0].relative(steps[1].x, steps[1].y)
    assert forward == pytest.approx(0.0, abs=1e-12)
    assert -left == pytest.approx(REACH.width)
    assert steps[1].yaw == pytest.approx(steps[0].yaw)


def test_clamped_keeps_what_is_inside() -> None:
    stance = Foothold(0.3, -0.2, 0.5)
    x, y = stance.moved(0.1, REACH.width)
    step = clamped(stance, LEFT, x, y, 0.55, limits_of(REACH))
    assert (step.x, step.y, step.yaw) == pytest.approx((x, y, 0.55))


def test_the_velocity_changes_no_faster_than_allowed() -> None:
    limits = GAIT.velocity
    target = limited((100.0, -100.0, 100.0), limits)
    velocity = approached((0.0, 0.0, 0.0), target, limits, 0.1)
    assert velocity[0] == pytest.approx(0.1 * limits.acceleration)
    assert velocity[2] == pytest.approx(0.1 * limits.turn_acceleration)
    for _ in range(100):
        velocity = approached(velocity, target, limits, 0.1)
    assert velocity == pytest.approx((limits.forward, -limits.lateral, limits.turn))
