"""The pace: smooth over speed and disturbance; steps that the robot can take at every velocity, and that make it."""

import math

import numpy as np
import pytest

from models.config import default_config
from models.robot_model import RobotModel
from models.types import Velocity
from planners.gait.config import GaitConfig, SpeedConfig
from planners.gait.footsteps import Foothold, Point, advance_of
from planners.gait.pace import longest_step, lost_share, pace_at, share_of, share_within, urgency_after, velocity_within
from planners.gait.scaling import load_gait_config
from planners.gait.speed import SpeedTrim

SHARES = np.linspace(0.0, 1.0, 201)
CONFIG = default_config(GaitConfig, "planners", "gait")
PACE = CONFIG.pace
SPEED = SpeedConfig(gain=0.2, most=0.15)
PERIOD = 0.4
MIDDLE: Point = (0.0, -0.1)


@pytest.fixture(scope="module", params=["g1", "talos"])
def config(request: pytest.FixtureRequest) -> GaitConfig:
    return load_gait_config(RobotModel.load(request.param))


def shares_along(direction: tuple[float, float, float], config: GaitConfig) -> np.ndarray:
    """Shares of the fast gait from standing to a velocity."""
    return np.array([share_of((u * direction[0], u * direction[1], u * direction[2]), config.pace) for u in SHARES])


@pytest.mark.parametrize(
    "direction", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0.5, 0.5, 0.5)]
)
def test_the_pace_is_smooth_over_the_speed(config: GaitConfig, direction: tuple[float, float, float]) -> None:
    pace = config.pace
    full = direction[0] * pace.forward, direction[1] * pace.lateral, direction[2] * pace.turn
    shares = shares_along(full, config)
    assert shares[0] == 0.0
    assert (np.diff(shares) >= 0.0).all()
    steepest = 1.5 / (1.0 - pace.slow_share)  # of the smooth step
    assert np.diff(shares).max() <= steepest * math.hypot(*direction) / (len(SHARES) - 1) + 1e-9
    assert (shares[SHARES * math.hypot(*direction) <= pace.slow_share] == 0.0).all()


def test_the_pace_is_slow_at_rest_and_fast_at_the_largest_velocities(config: GaitConfig) -> None:
    """The largest velocities are at least those of the fast gait, but for one that torques limit: TALOS forward."""
    limits, names = config.velocity, ("single", "double", "crouch", "clearance")
    slow, fast = (pace_at(share, config.pace) for share in (0.0, 1.0))
    assert [getattr(slow, name) for name in names] == pytest.approx([getattr(config.pace.slow, name) for name in names])
    assert [getattr(fast, name) for name in names] == pytest.approx([getattr(config.pace.fast, name) for name in names])
    for velocity in ((config.pace.forward, 0.0, 0.0), (0.0, limits.lateral, 0.0), (0.0, 0.0, limits.turn)):
        assert share_of(velocity, config.pace) == pytest.approx(1.0)
    g1 = config.leg < 0.7
    assert limits.forward >= config.pace.forward if g1 else 1.0 < limits.forward < config.pace.forward


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_velocity_is_within_reach_at_its_pace(config: GaitConfig, axis: int, sign: float) -> None:
    """Durations within the limits of the step times, and steps within those of the legs."""
    limits, reach, timing = config.velocity, config.reach, config.timing
    largest = (limits.forward if sign > 0.0 else limits.backward, limits.lateral, limits.turn)[axis]
    for u in SHARES:
        velocity = [0.0, 0.0, 0.0]
        velocity[axis] = sign * u * largest
        pace = pace_at(share_of((velocity[0], velocity[1], velocity[2]), config.pace), config.pace)
        assert timing.single_min <= pace.single <= timing.single_max
        forward, left, turn = advance_of((velocity[0], velocity[1], velocity[2]), pace.period)
        assert -reach.backward <= forward <= reach.forward
        trailing = max(reach.width - abs(left), reach.width_min)
        assert trailing + 2.0 * abs(left) <= reach.width_max
        assert 2.0 * abs(turn) - min(abs(turn), reach.turn_in) <= reach.turn_out


def test_a_dcm_error_makes_the_gait_fast_at_once_and_it_calms_down_later(config: GaitConfig) -> None:
    pace, dt = config.pace, 0.002
    errors = np.linspace(0.0, 2.0 * pace.alarm, 101)
    urgencies = np.array([urgency_after(0.0, error, dt, pace) for error in errors])
    assert (urgencies[errors <= pace.calm] == 0.0).all() and (urgencies[errors >= pace.alarm] == 1.0).all()
    assert (np.diff(urgencies) >= 0.0).all() and np.diff(urgencies).max() < 0.1
    urgency, ticks = 1.0, round(pace.calm_time / dt)
    for _ in range(ticks):
        urgency = urgency_after(urgency, 0.0, dt, pace)
    assert urgency == pytest.approx(math.exp(-1.0), abs=1e-3)
    assert urgency_after(urgency, pace.alarm, dt, pace) == 1.0


HEIGHT, WIDTH = 0.65, CONFIG.reach.width


def test_steps_of_a_grip_as_usual_are_not_limited() -> None:
    fastest = (CONFIG.velocity.forward, 0.0, 0.0)
    for friction in (0.8, math.inf):
        longest = longest_step(friction, HEIGHT, WIDTH, CONFIG.pace)
        assert share_within((0.4, 0.0, 0.0), longest, CONFIG.pace) == 0.0
        assert velocity_within(fastest, longest, CONFIG.pace) == fastest


@pytest.mark.parametrize("friction", [0.18, 0.2, 0.25, 0.3])
def test_the_ground_bears_the_steps_of_every_velocity(friction: float) -> None:
    longest = longest_step(friction, HEIGHT, WIDTH, CONFIG.pace)
    for forward, left in ((0.1, 0.0), (0.4, 0.1), (-0.3, 0.0), (1.0, 0.0)):
        velocity = velocity_within((forward, left, 0.2), longest, CONFIG.pace)
        share = share_within(velocity, longest, CONFIG.pace)
        length = math.hypot(*velocity[:2]) * pace_at(share, CONFIG.pace).period
        assert math.hypot(length, WIDTH) / (2.0 * HEIGHT) <= CONFIG.pace.friction_share * friction + 1e-9


def test_without_grip_the_robot_steps_on_the_spot() -> None:
    assert longest_step(0.05, HEIGHT, WIDTH, CONFIG.pace) == 0.0
    assert velocity_within((0.4, 0.1, 0.2), 0.0, CONFIG.pace) == (0.0, 0.0, 0.0)


def test_the_share_of_a_sole_without_ground() -> None:
    whole, half = np.array([[-0.05, 0.12, -0.025, 0.025]] * 2), np.array([[0.085, 0.025]] * 2)
    assert lost_share(whole, half) == pytest.approx(0.0)
    strip = np.array([[-0.05, 0.12, -0.025, -0.0125], whole[1]])
    assert lost_share(strip, half) == pytest.approx(0.75)
    edge = np.array([whole[0], [0.12, 0.12, -0.025, 0.025]])
    assert lost_share(edge, half) == 1.0


def walked(
    velocity: Velocity, share: float, strides: int, trim: SpeedTrim | None = None, drift: Velocity = (0.0, 0.0, 0.0)
) -> SpeedTrim:
    """After strides in which the body makes a share of the velocity that is asked for, and a drift, along its arc."""
    trim = trim or SpeedTrim()
    x, y, yaw = 0.3, -0.2, 0.5
    for _ in range(strides):
        forward, left, turn = (
            (share * part + more) * 2.0 * PERIOD for part, more in zip(trim.of(velocity), drift, strict=True)
        )
        before = sole_of(x, y, yaw)
        for _ in range(1000):  # along the arc
            x += 0.001 * (math.cos(yaw) * forward - math.sin(yaw) * left)
            y += 0.001 * (math.sin(yaw) * forward + math.cos(yaw) * left)
            yaw += 0.001 * turn
        trim = trim.landed(velocity, before, sole_of(x, y, yaw), MIDDLE, PERIOD, SPEED, PACE)
    return trim


def sole_of(x: float, y: float, yaw: float) -> Foothold:
    """The sole with the middle of both feet at a place."""
    return Foothold(*Foothold(x, y, yaw).moved(-MIDDLE[0], -MIDDLE[1]), yaw)


@pytest.mark.parametrize(
    "velocity", [(0.6, 0.0, 0.0), (-0.3, 0.0, 0.0), (0.0, -0.2, 0.0), (0.0, 0.0, 0.8), (0.4, 0.1, 0.5)]
)
def test_what_steps_fall_short_by_is_asked_for(velocity: Velocity) -> None:
    trim = walked(velocity, 0.95, 40)
    for part, asked in zip(velocity, trim.of(velocity), strict=True):
        assert 0.95 * asked == pytest.approx(part, rel=2e-3, abs=1e-9)


def test_a_walk_that_makes_its_velocity_is_left_alone() -> None:
    velocity = 0.4, 0.0, 0.5
    assert walked(velocity, 1.0, 20).of(velocity) == pytest.approx(velocity, abs=1e-3)


@pytest.mark.parametrize("velocity", [(0.0, 0.2, 0.0), (0.5, 0.0, 0.0), (0.0, 0.0, -0.4)])
def test_a_walk_that_goes_to_the_side_of_its_velocity_is_brought_back(velocity: Velocity) -> None:
    drift = 0.01, -0.004, 0.02
    asked = walked(velocity, 0.97, 60, drift=drift).of(velocity)
    made = [0.97 * part + more for part, more in zip(asked, drift, strict=True)]
    assert made == pytest.approx(velocity, abs=2e-3)


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_walk_that_is_held_is_not_driven_on_without_bound(share: float) -> None:
    asked = walked((0.4, 0.0, 0.0), share, 60).of((0.4, 0.0, 0.0))
    assert abs(asked[0] / 0.4 - 1.0) == pytest.approx(SPEED.most)


def test_a_stride_at_two_velocities_does_not_count() -> None:
    trim = walked((0.4, 0.0, 0.0), 0.9, 1)
    assert trim.matrix == SpeedTrim().matrix
    assert walked((0.5, 0.0, 0.0), 0.9, 1, trim).matrix == SpeedTrim().matrix
    assert walked((0.4, 0.0, 0.0), 0.9, 1, trim).matrix[0][0] > 0.0


def test_each_side_has_its_own_correction() -> None:
    """Steps to either side go ahead: what was learned to the left does not make it worse to the right, nor is lost."""
    drift = 0.01, 0.0, 0.0
    left = walked((0.0, 0.2, 0.0), 1.0, 60, drift=drift)
    assert left.of((0.0, -0.2, 0.0))[0] == 0.0
    both = walked((0.0, -0.2, 0.0), 1.0, 60, left, drift=drift)
    for side in (0.2, -0.2):
        assert both.of((0.0, side, 0.0)) == pytest.approx((-0.01, side, 0.0), abs=1e-3)


def test_one_step_far_off_hardly_counts() -> None:
    """A step after a push, to the side: the walk goes on nearly as commanded."""
    velocity = 0.4, 0.0, 0.0
    asked = walked(velocity, 1.0, 2, drift=(0.0, 0.2, 0.0)).of(velocity)
    assert abs(asked[1]) <= SPEED.gain * SPEED.most * 0.4 * PACE.lateral / PACE.forward + 1e-9
