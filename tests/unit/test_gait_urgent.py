"""What an urgent step may do that others may not, and what keeps the legs and the QP within their limits meanwhile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from controllers.qp.kernels_feedback import foothold_feedback
from models.config import default_config
from models.robot_model import RobotModel
from models.types import RobotState
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.gait import GaitPlanner
from planners.gait.leg_lever import leg_lever
from planners.gait.measurement import GaitMeasurement
from planners.gait.phase import GaitPhase
from planners.gait.reaction import SwingReaction
from planners.gait.reference import ReferenceBuilder
from planners.gait.scaling import foot_speed, load_gait_config
from planners.gait.soles import Soles
from tests.gaits import DT, in_single_support
from tests.support import standing


@pytest.fixture(scope="module")
def g1() -> RobotModel:
    return RobotModel.load("g1")


def pushed(planner: GaitPlanner, shares: tuple[float, float] = (0.5, 0.5)) -> RobotState:
    """The robot is pushed to the side of its swing foot."""
    v = np.zeros(planner.model.nv)
    v[1] = 1.0 if planner.stance == 1 else -1.0  # [m/s]
    return standing(planner.model, v=v, shares=shares)


def test_a_push_makes_a_step_quick_and_wide(g1: RobotModel) -> None:
    """Pushed outwards in single support, the swing foot may land sooner and wider than on any other step."""
    planner = in_single_support(g1)
    timing, reach = planner.config.timing, planner.config.reach
    foot = 1 - planner.stance
    side = 1.0 if foot == 0 else -1.0
    for _ in range(40):
        planner.step(pushed(planner), DT)
    assert planner.phase is GaitPhase.SINGLE
    place = planner.footholds[planner.stance].relative(planner.footholds[foot].x, planner.footholds[foot].y)
    assert reach.width_max < side * place[1] <= reach.width_urgent + 1e-9
    assert timing.single_urgent - 1e-9 <= planner.step_time < timing.single_min


@pytest.mark.parametrize("urgent", [True, False])
def test_an_urgent_step_goes_on_through_a_moment_in_the_air(g1: RobotModel, urgent: bool) -> None:
    config = load_gait_config(g1)
    threshold = config.adjustment.urgent if urgent else 1.0
    planner = in_single_support(g1, replace(config, adjustment=replace(config.adjustment, urgent=threshold)))
    for _ in range(20):
        planner.step(pushed(planner), DT)
    for _ in range(round(1.5 * planner.config.lift.float_time / DT)):
        reference = planner.step(pushed(planner, (0.0, 0.0)), DT)
    assert any(reference.contacts) == urgent


def test_limits_of_an_urgent_step_are_no_narrower(g1: RobotModel) -> None:
    config = default_config(GaitConfig, "planners", "gait")
    with pytest.raises(ValueError, match="urgent"):
        replace(config, reach=replace(config.reach, width_urgent=config.reach.width_max - 0.01))
    with pytest.raises(ValueError, match="astride"):
        replace(config, astride=config.astride_max)
    with pytest.raises(ValueError, match="urgent"):
        replace(config, timing=replace(config.timing, single_urgent=config.timing.single_min + 0.01))


def test_slow_joints_make_a_slow_foot() -> None:
    talos = RobotModel.load("talos")
    config = load_gait_config(talos)
    assert config.swing.speed_max == pytest.approx(config.swing.speed_share * foot_speed(talos))
    assert config.swing.speed_max < default_config(GaitConfig, "planners", "gait").swing.speed_max


def test_feet_far_apart_lower_the_body(g1: RobotModel) -> None:
    config = load_gait_config(g1)
    builder = ReferenceBuilder(g1, config, SwingReaction(leg_lever(g1)))
    com = np.zeros(2)

    def height(left: float, swinging: int | None, lean: float = 0.5) -> float:
        holds = [Foothold(builder._under[0][0], left, 0.0), Foothold(*(float(x) for x in builder._under[1]), 0.0)]
        return builder._in_reach(holds, swinging, com, lean, 0.0)

    stand = height(float(builder._under[0][1]), None)
    assert stand == pytest.approx(builder.height, abs=1e-9)  # no lower than it stands
    assert height(0.5, None) < height(0.3, None) < stand  # planted: from where it is measured
    assert height(0.5, 0, 0.7) < height(0.5, 0, 0.5) < stand  # swinging: from where it will be
    assert height(0.5, None) < height(0.5, 0, 0.5)


def test_how_far_astride_the_soles_are(g1: RobotModel) -> None:
    config, measured = load_gait_config(g1), GaitMeasurement(g1)
    soles = Soles(g1, config)
    measured.update(standing(g1))
    soles.reset(measured)
    assert not soles.astride(config.astride)
    off = 0.5 * (config.astride + config.astride_max)
    soles.holds[0] = structs.replace(soles.holds[0], y=soles.holds[0].y + off)
    assert soles.astride(config.astride) and not soles.astride(config.astride_max)
    soles.reset(measured)
    soles.holds[0] = structs.replace(soles.holds[0], x=soles.holds[0].x - off)
    assert soles.astride(config.astride) and not soles.astride(config.astride_max)


def test_what_draws_a_planted_sole_is_bounded() -> None:
    """A sole that rolls over its edge at radians a second is stopped by the floor, not by the legs."""
    pose, twist, out = np.eye(4), np.array([2.0, 0.1, 0.0, 0.0, -5.0, 0.1]), np.empty(6)
    gains = np.array([200.0, 28.0, 0.0, 0.0, 0.0, 10.0, 20.0])
    foothold_feedback(pose, twist, np.eye(3), np.zeros(3), gains, out)
    assert out == pytest.approx([-10.0, -2.8, 0.0, 0.0, 20.0, -2.8])
