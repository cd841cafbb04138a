"""Height of the body: its rise over the stance leg, and on the way to where both legs reach the feet keep bearing."""

import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from models.constants import GRAVITY
from models.robot_model import RobotModel
from planners.gait.planner import GaitPlanner
from planners.gait.reference import ReferenceBuilder
from planners.gait.scaling import load_gait_config
from planners.gait.state import GaitPhase

DT, SINGLE, DOUBLE = 0.001, 0.50, 0.04
PERIOD = SINGLE + DOUBLE


def risen(robot: RobotModel, apart: float, steps: int = 4, early: float = 0.0, limit: float = 1.5) -> np.ndarray:
    """Rise, its rate and acceleration in the ticks of a walk with feet this far apart (n, 3) [m]."""
    config = load_gait_config(robot)
    config = replace(config, rise=replace(config.rise, acceleration=limit))
    builder, gait = ReferenceBuilder(robot, config), GaitPlanner(robot).state.copy()
    left, right = gait.soles.holds
    gait.soles = structs.replace(gait.soles, holds=(left, right.shifted(left.x - apart - right.x, 0.0)))
    gait.step = structs.replace(gait.step, time=SINGLE, double=DOUBLE)
    rows = []
    for _ in range(steps):
        for gait.phase, time in ((GaitPhase.DOUBLE, DOUBLE), (GaitPhase.SINGLE, SINGLE - early)):
            for i in range(round(time / DT)):
                gait.elapsed = (i + 1) * DT
                gait.body = builder.advance_body(gait, 0.0, 3.8, DT)
                rows.append(gait.body.rise)
    return np.array(rows)


def test_the_com_is_highest_after_the_middle_of_the_stance_and_lowest_after_a_touchdown(g1: RobotModel) -> None:
    rise, config = risen(g1, 0.3)[-round(PERIOD / DT) :, 0], load_gait_config(g1)
    size = config.rise.share * 0.3**2 / (16.0 * config.leg)
    crest = DOUBLE + config.rise.crest * SINGLE
    assert np.argmax(rise) * DT == pytest.approx(crest, abs=0.02)
    assert np.argmin(rise) * DT == pytest.approx(crest - 0.5 * PERIOD, abs=0.02)
    assert (rise.max(), -rise.min()) == pytest.approx((size, size), rel=0.05)


@pytest.mark.parametrize("early", [0.0, 0.06])
def test_it_is_smooth_when_a_foot_lands_early_too(g1: RobotModel, early: float) -> None:
    rows = risen(g1, 0.3, early=early)
    for i, largest in ((0, 1e-5), (1, 1e-3)):  # of the difference to the mean of the rate over a tick
        change, mean = np.diff(rows[:, i]), 0.5 * DT * (rows[1:, i + 1] + rows[:-1, i + 1])
        assert np.abs(change - mean).max() < largest * DT**0.5


def test_its_acceleration_is_bounded(g1: RobotModel) -> None:
    free, bound = (risen(g1, 0.5, limit=limit)[-round(PERIOD / DT) :] for limit in (100.0, 0.5))
    assert np.abs(bound[:, 2]).max() == pytest.approx(0.5, rel=0.05)
    assert np.abs(free[:, 2]).max() > 1.5
    assert np.abs(bound[:, 0]).max() == pytest.approx(0.5 * (0.5 * PERIOD / math.pi) ** 2, rel=0.05)


def test_there_is_none_on_the_spot(g1: RobotModel) -> None:
    assert np.abs(risen(g1, 0.0)).max() < 1e-12


def heights(robot: RobotModel, *, urgent: bool) -> np.ndarray:
    """Height of the body, its rate and acceleration after a touchdown far to the side (n, 3) [m]."""
    config = load_gait_config(robot)
    builder, gait = ReferenceBuilder(robot, config), GaitPlanner(robot).state.copy()
    left, right = gait.soles.holds
    gait.soles = structs.replace(gait.soles, holds=(left.shifted(0.0, 0.4), right))
    gait.phase, gait.step = GaitPhase.DOUBLE, structs.replace(gait.step, urgent=urgent)
    rows = []
    for i in range(400):
        gait.elapsed = (i + 1) * DT
        gait.body = builder.advance_body(gait, 0.0, 3.8, DT)
        rows.append((gait.body.height, gait.body.rate, gait.body.acceleration))
    return np.array(rows)


@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_a_wide_step_lowers_the_body_and_leaves_half_of_the_weight_on_the_feet(robot: str) -> None:
    model = RobotModel.load(robot)
    rows, urgent = heights(model, urgent=False), heights(model, urgent=True)
    assert rows[-1, 0] < rows[0, 0] - 0.02
    assert np.abs(rows[:, 2]).max() < 0.5 * GRAVITY  # at 0.8 of it TALOS' feet lost all load
    assert np.abs(urgent[:, 2]).max() < GRAVITY
    config, time = load_gait_config(model), 51 * DT
    more = config.height_acceleration_urgent - config.height_acceleration  # less for TALOS, whose hip is weak
    assert rows[50, 0] - urgent[50, 0] == pytest.approx(0.5 * more * time**2, rel=0.05)
