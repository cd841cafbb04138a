"""Soles of the gait: where a foot is expected to land, which planted soles are followed, when standing is lost."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from models.config import default_config
from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.soles import Soles

CONFIG = default_config(GaitConfig, "planners", "gait")


def measured(
    left_z: float = 0.0,
    right_z: float = 0.0,
    loads: tuple[float, float] = (0.5, 0.5),
    tilt: tuple[float, float] = (0.0, 0.0),
) -> SimpleNamespace:
    soles = [Foothold(0.0, 0.1, 0.0, left_z), Foothold(0.0, -0.1, 0.0, right_z)]
    return SimpleNamespace(soles=soles, loads=loads, tilts=np.array([tilt, tilt]))


@pytest.fixture()
def soles() -> Soles:
    made = Soles(RobotModel.load("g1"), CONFIG)
    made.reset(measured())
    return made


def test_a_foot_is_expected_to_land_as_high_as_before(soles: Soles) -> None:
    assert soles.landing_height(0, measured()) == 0.0
    for _ in range(20):
        soles.land(0, measured(left_z=0.012, right_z=0.002))
    assert soles.landing_height(0, measured(right_z=0.002)) == pytest.approx(0.012, abs=1e-5)
    assert soles.landing_height(1, measured(left_z=0.012)) == 0.012  # the other foot has its own habit
    soles.reset(measured())
    assert soles.landing_height(0, measured()) == 0.0


def test_the_expected_rise_is_bounded(soles: Soles) -> None:
    for sign in (1.0, -1.0):
        for _ in range(20):
            soles.land(0, measured(left_z=sign * 0.5))
        assert soles.landing_height(0, measured()) == pytest.approx(sign * CONFIG.swing.rise_max)


def test_one_bump_hardly_changes_the_expected_rise(soles: Soles) -> None:
    soles.land(0, measured(left_z=0.03))
    assert soles.landing_height(0, measured()) == pytest.approx(CONFIG.swing.rise_step)


def test_a_foot_is_expected_to_land_in_the_slope_of_the_last_soles(soles: Soles) -> None:
    inclined = measured(right_z=0.2, tilt=(0.1, -0.05))
    for i in range(CONFIG.ground.slope_steps):
        assert bool(soles.slope[0] > 0.05) is (i > CONFIG.ground.slope_steps // 2)
        soles.land(i % 2, inclined)
    assert soles.slope == pytest.approx([0.1, -0.05])
    soles._rise[0] = 0.0
    soles.holds[0] = Foothold(0.2, 0.1, 0.0)
    assert soles.landing_height(0, inclined) == pytest.approx(0.2 + 0.2 * 0.1 - 0.2 * 0.05)
    for _ in range(3):
        soles.land(0, measured(tilt=(5.0, 0.0)))
    assert soles.slope[0] == CONFIG.ground.slope_max


def test_one_sole_on_an_edge_is_no_slope(soles: Soles) -> None:
    for i, tilt in enumerate((0.0, 0.2, 0.01, 0.0)):
        soles.land(i % 2, measured(tilt=(tilt, 0.0)))
        assert soles.slope[0] <= 0.01


def test_a_sole_that_has_just_landed_lies_down_and_one_that_tips_does_not(soles: Soles) -> None:
    tipped = measured(loads=(0.5, 0.5), tilt=(0.1, 0.0))
    soles.follow(tipped, None, 0, CONFIG.ground.settle_time)
    assert soles.tilts[0] == pytest.approx([0.1, 0.0])
    assert soles.tilts[1, 0] == pytest.approx(0.1 * CONFIG.ground.settle_time / CONFIG.ground.anchor_time)


def test_only_planted_soles_that_bear_are_followed(soles: Soles) -> None:
    moved = measured(left_z=0.01, right_z=0.01)
    soles.follow(moved, 0, None, CONFIG.anchor_time)
    assert [hold.z for hold in soles.holds] == [0.0, 0.01]
    soles.follow(measured(left_z=0.01, loads=(0.5 * CONFIG.anchor_load, 1.0)), None, None, CONFIG.anchor_time)
    assert soles.holds[0].z == 0.0


def test_standing_is_lost_near_the_edge_of_the_box_around_both_soles(soles: Soles) -> None:
    middle = soles.middle()
    x_edge = float(soles.half_sole(0)[0]) * CONFIG.step_share
    assert not soles.beyond_standing(middle + np.array([x_edge - 1e-3, 0.0]))
    assert soles.beyond_standing(middle + np.array([x_edge + 1e-3, 0.0]))
    y_edge = (0.1 + float(soles.half_sole(0)[1])) * CONFIG.step_share
    assert not soles.beyond_standing(middle + np.array([0.0, y_edge - 1e-3]))
    assert soles.beyond_standing(middle + np.array([0.0, y_edge + 1e-3]))


def test_the_weight_is_shared_by_where_the_zmp_lies(soles: Soles) -> None:
    left, right = soles.point(0), soles.point(1)
    assert soles.shares(left) == pytest.approx((1.0, 0.0))
    assert soles.shares(0.75 * left + 0.25 * right) == pytest.approx((0.75, 0.25))
    assert soles.shares(right + (right - left)) == pytest.approx((0.0, 1.0))
