"""The swing foot: smooth, clear of the floor, at its target on time, and patient when the floor is lower."""

import numpy as np
import pytest

from models.config import default_config
from models.spline import quintic_step
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.swing import SwingFoot, SwingState

CONFIG = default_config(GaitConfig, "planners", "gait").swing
FOOT = SwingFoot(CONFIG)
DT, DURATION, CLEARANCE = 0.001, 0.34, 0.05
START = np.array([0.0, 0.1, 0.0, 0.0])
LEVEL = np.zeros(2)


def swing(targets: list[np.ndarray], durations: list[float], until: int) -> np.ndarray:
    """Positions, velocities and accelerations of every tick (n, 3, 4)."""
    foot = FOOT.lift(START, CLEARANCE, DURATION, LEVEL)
    rows = []
    for i in range(until):
        target, duration = targets[min(i, len(targets) - 1)], durations[min(i, len(durations) - 1)]
        foot = FOOT.step(foot, target, LEVEL, (i + 1) * DT, duration, DT)
        rows.append(foot.motion)
    return np.array(rows)


def test_it_lands_on_its_target_on_time_with_the_landing_velocity() -> None:
    target = np.array([0.3, 0.12, 0.01, 0.2])
    rows = swing([target], [DURATION], round(DURATION / DT))
    position, velocity = rows[-1, 0], rows[-1, 1]
    assert position == pytest.approx(target, abs=2e-3)
    assert velocity[:2] == pytest.approx(np.zeros(2), abs=0.05)
    assert velocity[2] == pytest.approx(-CONFIG.landing_velocity, abs=0.02)
    assert rows[:, 0, 2].max() == pytest.approx(target[2] + CLEARANCE, abs=0.005)


@pytest.mark.parametrize("moving", [False, True])
def test_position_and_velocity_are_continuous(moving: bool) -> None:
    ticks = round(DURATION / DT)
    target = np.array([0.3, 0.12, 0.0, 0.2])
    targets = [target + (np.array([0.05, 0.02, 0.0, 0.0]) if moving and i > 120 else 0.0) for i in range(ticks)]
    durations = [DURATION - (0.04 if moving and i > 120 else 0.0) for i in range(ticks)]
    rows = swing(targets, durations, ticks - 45)
    assert np.abs(np.diff(rows[:, 0], axis=0) / DT - rows[1:, 1]).max() < 0.05
    assert np.abs(np.diff(rows[:, 1], axis=0)).max() < 0.15
    assert rows[0, 1] == pytest.approx(np.zeros(4), abs=0.02)


def test_it_clears_the_floor_between_lift_off_and_landing() -> None:
    rows = swing([np.array([0.3, 0.1, 0.0, 0.0])], [DURATION], round(DURATION / DT))
    moving = np.abs(rows[:, 1, 0]) > 0.3
    assert rows[moving, 0, 2].min() > 0.004


def test_a_late_foot_goes_on_down_and_not_for_ever() -> None:
    rows = swing([np.array([0.3, 0.1, 0.0, 0.0])], [DURATION], 1400)
    late = rows[round(DURATION / DT) + 2 :]
    assert (np.diff(late[:, 0, 2]) <= 1e-12).all()
    assert late[0, 1, 2] == pytest.approx(-CONFIG.late_velocity)
    assert late[-1, 0, 2] == pytest.approx(-CONFIG.depth_max, abs=2e-3)
    assert np.abs(np.diff(late[:, 0, :2], axis=0)).max() < 1e-4


def test_a_late_foot_follows_its_target() -> None:
    ticks = round(DURATION / DT)
    targets = [np.array([0.3, 0.1, 0.0, 0.0])] * (ticks + 1) + [np.array([0.3, 0.14, 0.0, 0.0])]
    rows = swing(targets, [DURATION], ticks + 1 + round(CONFIG.late_time / DT))
    assert rows[-1, 0, 1] == pytest.approx(0.1 + 0.04 * (1.0 - np.exp(-1.0)), abs=1e-3)


def test_a_late_foot_does_not_lag_behind_a_target_that_moves() -> None:
    velocity, foot = 0.5, FOOT.lift(START, CLEARANCE, DURATION, LEVEL)
    for i in range(600):
        late = (i + 1) * DT - DURATION
        target = np.array([0.3 + velocity * max(late, 0.0), 0.1, 0.0, 0.0])
        foot = FOOT.step(foot, target, LEVEL, (i + 1) * DT, DURATION, DT, target_velocity=(velocity, 0.0))
    assert foot.position[0] == pytest.approx(target[0], abs=1e-3)
    assert foot.velocity[0] == pytest.approx(velocity, abs=1e-2)


TARGET = np.array([0.3, 0.1, 0.0, 0.0])


def at_place(x: float, y: float) -> Foothold:
    return Foothold(float(x), float(y), 0.0, 0.02)


def tripped(at: float, lag: float, force: float = 2.0) -> tuple[SwingState, float]:
    """A foot ``lag`` behind its reference, pushed back by a multiple of the force of a trip, is checked at a time.

    Returns:
        The foot and its height then.
    """
    foot = FOOT.lift(START, CLEARANCE, DURATION, LEVEL)
    for i in range(round(at / DT)):
        foot = FOOT.step(foot, TARGET, LEVEL, (i + 1) * DT, DURATION, DT)
    place = at_place(foot.position[0] - lag, foot.position[1])
    push = np.array([-force * CONFIG.trip_force, 0.0, 0.0])
    return FOOT.detect_trip(foot, place, push, at, DURATION), float(foot.position[2])


def test_a_foot_that_trips_gives_way_and_only_rises_for_a_while() -> None:
    at = 0.08
    lag = 1.1 * CONFIG.trip_lag
    free, height = tripped(at, 0.0)
    foot, _ = tripped(at, lag)
    assert (free.trips, foot.trips) == (0, 1)
    assert free.edge == -np.inf and foot.edge == 0.02
    place = float(foot.position[0])
    assert free.position[:2] - foot.position[:2] == pytest.approx([lag + CONFIG.trip_back, 0.0])
    assert foot.velocity[0] == 0.0
    elapsed = at
    while elapsed < at + CONFIG.trip_time - 2 * DT:
        elapsed += DT
        # Still held: it rises on, and does not trip again.
        foot = FOOT.detect_trip(foot, at_place(place - 1.0, 0.0), np.array([-1.0, 0.0, 0.0]), elapsed, DURATION)
        foot = FOOT.step(foot, TARGET, LEVEL, elapsed, DURATION, DT)
        assert foot.position[0] == pytest.approx(place)
    assert foot.trips == 1
    assert foot.position[2] > max(height, 0.9 * CLEARANCE)
    while elapsed < DURATION - 1e-9:
        elapsed += DT
        foot = FOOT.step(foot, TARGET, LEVEL, elapsed, DURATION, DT)
    assert foot.position == pytest.approx(TARGET, abs=5e-3)


@pytest.mark.parametrize(("lag", "force"), [(0.9, 2.0), (3.0, 0.9), (-3.0, 2.0)])
def test_a_foot_that_is_near_or_only_lags_or_is_pushed_to_its_reference_does_not_trip(lag: float, force: float) -> None:
    foot, _ = tripped(0.06, lag * CONFIG.trip_lag, force)
    assert foot.trips == 0 and foot.velocity[0] > 0.1


@pytest.mark.parametrize(("share", "rises"), [(0.75, True), (1.05, False)])
def test_a_foot_that_trips_rises_again_until_its_planned_touchdown(share: float, rises: bool) -> None:
    at = share * DURATION
    foot, height = tripped(at, 1.1 * CONFIG.trip_lag)
    assert foot.trips == 1 and foot.velocity[0] == 0.0
    elapsed, duration = at, DURATION + (CONFIG.trip_landing if rises else 0.0)
    for _ in range(round(CONFIG.trip_time / DT)):
        elapsed += DT
        foot = FOOT.step(foot, TARGET, LEVEL, elapsed, duration, DT)
    assert (foot.position[2] > height) == rises


def test_the_sole_turns_to_the_slope_expected_at_its_landing() -> None:
    slope = np.array([0.1, -0.05])
    foot = FOOT.lift(START, CLEARANCE, DURATION, np.array([0.02, 0.0]))
    assert foot.tilt == pytest.approx([0.02, 0.0])
    for i in range(round(DURATION / DT)):
        foot = FOOT.step(foot, START, slope, (i + 1) * DT, DURATION, DT)
    assert foot.tilt == pytest.approx(slope, abs=0.005)


def test_a_tick_leaves_the_state_before_it_alone() -> None:
    foot = FOOT.lift(START, CLEARANCE, DURATION, LEVEL)
    motion, tilt = foot.motion.copy(), foot.tilt.copy()
    FOOT.step(
        FOOT.detect_trip(foot, at_place(0.5, 0.5), np.array([1.0, 1.0, 0.0]), 0.01, DURATION),
        TARGET,
        np.ones(2),
        0.01,
        DURATION,
        DT,
    )
    np.testing.assert_array_equal(foot.motion, motion)
    np.testing.assert_array_equal(foot.tilt, tilt)


def test_a_quintic_step_over_the_whole_time_ends_at_the_end() -> None:
    end = (0.4, -0.1, 0.3)
    assert quintic_step(0.1, 0.5, -2.0, end, 0.3, 0.3) == pytest.approx(end)


def test_the_path_of_least_effort_accelerates_less() -> None:
    """The cubic has 7 / 10 of the mean square acceleration of the path of least jerk, and both land on the target."""
    squares = []
    for effort in (0.0, 1.0):
        foot = FOOT.lift(START, CLEARANCE, DURATION, LEVEL, target=(TARGET[0], TARGET[1]), effort=effort)
        along = []
        for i in range(round((DURATION - CONFIG.freeze) / DT)):
            foot = FOOT.step(foot, TARGET, LEVEL, (i + 1) * DT, DURATION, DT, effort=effort)
            along.append(foot.motion[2, 0])
        u = 1.0 - CONFIG.freeze / DURATION
        share = u * u * (3.0 - 2.0 * u) if effort else u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
        assert foot.position[0] == pytest.approx(share * TARGET[0], abs=1e-6)
        squares.append(np.mean(np.square(along)))
    assert squares[1] < 0.75 * squares[0]
