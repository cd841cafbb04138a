"""Integral of the posture error of joints that friction holds."""

from __future__ import annotations

import numpy as np
import pytest

from controllers.stuck_joints import StuckJoints
from controllers.upper_body import free_joints
from controllers.whole_body_config import BalanceConfig
from models.config import default_config
from models.robot_model import RobotModel

CONFIG = default_config(BalanceConfig, "controllers", "balance").stuck


def test_an_error_that_stays_adds_up_in_arms_and_head_alone(g1: RobotModel) -> None:
    law, zero, free = StuckJoints(g1, CONFIG), np.zeros(g1.nj), free_joints(g1)
    for _ in range(100):
        given = law.step(np.full(g1.nj, 0.05), zero, zero, 1e-3)
    assert given[free] == pytest.approx(CONFIG.gain * 0.05 * 0.1) and not given[~free].any()
    for _ in range(5000):
        given = law.step(np.full(g1.nj, -0.05), zero, zero, 1e-3)
    assert given[free] == pytest.approx(-CONFIG.most)
    law.reset()
    assert not law.acceleration.any()


def test_nothing_adds_up_at_the_goal_nor_in_a_push(g1: RobotModel) -> None:
    law, zero, one = StuckJoints(g1, CONFIG), np.zeros(g1.nj), np.ones(g1.nj)
    for error, speed in ((0.5 * CONFIG.error_least, 0.0), (1.1 * CONFIG.error_most, 0.0), (0.05, 1.1 * CONFIG.speed)):
        assert not law.step(error * one, zero, speed * one, 1e-3).any()


def test_a_joint_that_moves_forgets_and_a_tick_leaves_the_last_one_alone(g1: RobotModel) -> None:
    law, zero, one, free = StuckJoints(g1, CONFIG), np.zeros(g1.nj), np.ones(g1.nj), free_joints(g1)
    before = law.step(0.1 * one, zero, zero, 0.1)
    kept = before.copy()
    after = law.step(0.1 * one, zero, one, 0.5 * CONFIG.fade_s)
    np.testing.assert_array_equal(before, kept)
    np.testing.assert_allclose(after[free], 0.5 * kept[free])
