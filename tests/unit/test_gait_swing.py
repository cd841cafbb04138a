"""The swing foot: smooth, clear of the floor, at its target on time, and patient when the floor is lower."""

from __future__ import annotations

import numpy as np
import pytest

from models.config import default_config
from planners.gait.config import GaitConfig
from planners.gait.swing import SwingFoot, quintic_step

CONFIG = default_config(GaitConfig, "planners", "gait").swing
DT, DURATION = 0.001, 0.34
START = np.array([0.0, 0.1, 0.0, 0.0])


def swing(targets: list[np.ndarray], durations: list[float], until: int) -> np.ndarray:
    """Positions, velocities and accelerations of every tick (n, 3, 4)."""
    foot = SwingFoot(CONFIG)
    foot.lift(START, DURATION)
    rows = []
    for i in range(until):
        foot.step(targets[min(i, len(targets) - 1)], (i + 1) * DT, durations[min(i, len(durations) - 1)], DT)
        rows.append([foot.position.copy(), foot.velocity.copy(), foot.acceleration.copy()])
    return np.array(rows)


def test_it_lands_on_its_target_on_time_with_the_landing_velocity() -> None:
    target = np.array([0.3, 0.12, 0.01, 0.2])
    rows = swing([target], [DURATION], round(DURATION / DT))
    position, velocity = rows[-1, 0], rows[-1, 1]
    assert position == pytest.approx(target, abs=2e-3)
    assert velocity[:2] == pytest.approx(np.zeros(2), abs=0.05)
    assert velocity[2] == pytest.approx(-CONFIG.landing_velocity, abs=0.02)
    assert rows[:, 0, 2].max() == pytest.approx(target[2] + CONFIG.clearance, abs=0.005)


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


def test_a_late_foot_goes_on_down_gently_and_not_for_ever() -> None:
    rows = swing([np.array([0.3, 0.1, 0.0, 0.0])], [DURATION], 1400)
    late = rows[round(DURATION / DT) + 2 :]
    assert (np.diff(late[:, 0, 2]) <= 1e-12).all()
    assert late[-1, 0, 2] == pytest.approx(-CONFIG.depth_max, abs=2e-3)
    assert np.abs(np.diff(late[:, 0, :2], axis=0)).max() < 1e-9


def test_a_quintic_step_over_the_whole_time_ends_at_the_end() -> None:
    end = (0.4, -0.1, 0.3)
    assert quintic_step(0.1, 0.5, -2.0, end, 0.3, 0.3) == pytest.approx(end)
