"""What an urgent step may do that others may not, and what keeps the legs and the QP within their limits meanwhile."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from controllers.balance.controller import BalanceController
from controllers.qp.contacts import ContactGains, hold_contact
from controllers.whole_body.config import load_whole_body_config
from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Mode, RobotState
from planners.gait.config import GaitConfig
from planners.gait.contact import Soles
from planners.gait.measurement import GaitMeasurement
from planners.gait.planner import GaitPlanner
from planners.gait.reference import ReferenceBuilder, height_in_reach
from planners.gait.scaling import foot_speed, load_gait_config
from planners.gait.state import GaitPhase
from tests.gaits import DT, in_single_support, on_one_foot
from tests.support import standing


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
    assert timing.single_urgent - 1e-9 <= planner.state.step.time < timing.single_min


def test_the_base_has_more_weight_while_a_step_is_urgent(g1: RobotModel) -> None:
    planner, controller = GaitPlanner(g1), BalanceController(g1)
    controller.set_gait(planner)
    controller.reset(standing(g1))
    controller.enter(Mode.WALK)
    weight, stepping = controller.whole_body.tasks["base_orientation"].weight, controller.whole_body.config.stepping
    planner.set_velocity(0.3, 0.0, 0.0)
    while planner.phase is not GaitPhase.SINGLE:
        controller.step(standing(g1), DT)
    for _ in range(40):
        controller.step(pushed(planner, on_one_foot(planner.stance)), DT)
    assert planner.state.step.urgent and weight == pytest.approx(np.full(3, stepping.base_weight_urgent))
    controller.schedule.apply(1.0, 1.0)
    assert weight == pytest.approx(np.full(3, stepping.base_weight))


@pytest.mark.parametrize("calm", [0.0, 30.0])
def test_a_task_is_active_whenever_its_scheduled_weight_is_not_zero(g1: RobotModel, calm: float) -> None:
    config = load_whole_body_config(g1)
    base = replace(config.base_orientation, weight=0.0)
    config = replace(config, base_orientation=base, stepping=replace(config.stepping, base_weight=calm))
    controller = BalanceController(g1, whole_body=config)
    task, schedule = controller.whole_body.tasks["base_orientation"], controller.schedule
    assert not task.active
    schedule.apply(1.0, 1.0)
    assert task.active == (calm > 0.0)
    schedule.apply(1.0, 1.0, urgent=True)
    assert task.active
    schedule.apply(0.0, 1.0)
    assert not task.active


def test_in_an_urgent_step_a_foot_that_bears_alone_bears_what_the_fall_leaves_of_the_weight(
    g1: RobotModel,
) -> None:
    planner = in_single_support(g1)
    config, calm = planner.config, standing(g1, shares=on_one_foot(planner.stance))
    assert planner.step(calm, DT).load_alone == 0.0  # on uneven ground it may have lost the floor
    loads = [planner.step(pushed(planner), DT).load_alone for _ in range(40)]
    assert loads[-1] == pytest.approx(1.0 - config.height_acceleration_urgent / GRAVITY)


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


@pytest.mark.parametrize("rear", ["bears", "on the floor", "off the floor"])
def test_double_support_ends_when_the_rear_foot_leaves_the_floor(g1: RobotModel, rear: str) -> None:
    planner = in_single_support(g1)
    planner.set_velocity(0.2, 0.0, 0.0)
    while planner.phase is GaitPhase.SINGLE:
        planner.step(standing(g1), DT)
    assert planner.phase is GaitPhase.DOUBLE
    foot = 1 - planner.stance
    q = g1.standing_configuration()
    if rear == "off the floor":
        knee = g1.pin.getJointId(f"{('left', 'right')[foot]}_knee_joint")
        q[g1.pin.joints[knee].idx_q] += 0.3
    shares = (0.5, 0.5) if rear == "bears" else on_one_foot(1 - foot)
    for _ in range(2):
        planner.step(standing(g1, shares=shares, q=q), DT)
    assert planner.phase is (GaitPhase.SINGLE if rear == "off the floor" else GaitPhase.DOUBLE)
    assert 1 - planner.stance == foot


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
    builder, com = ReferenceBuilder(g1, config), np.zeros(2)
    (x, y), (right_x, right_y) = builder.under.tolist()

    def height(left: float, swinging: int, lean: float = 0.5) -> float:
        places = ((x, left), (right_x, right_y))
        return height_in_reach(
            places, (0.0, 0.0), builder.under, swinging, com, lean, 0.0, config.leg, builder.standing_height
        )

    stand = height(y, -1)
    assert stand == pytest.approx(builder.standing_height, abs=1e-9)  # no lower than it stands
    assert height(0.5, -1) < height(0.3, -1) < stand  # planted: from the measured place
    assert height(0.5, 0, 0.7) < height(0.5, 0, 0.5) < stand  # swinging: from the coming place
    assert height(0.5, -1) < height(0.5, 0, 0.5)


@pytest.mark.parametrize(("axis", "sign"), [("y", 1.0), ("x", -1.0)])
def test_how_far_astride_the_soles_are(g1: RobotModel, axis: str, sign: float) -> None:
    config = load_gait_config(g1)
    soles, (left, right) = Soles(g1, config), GaitMeasurement(g1).measure(standing(g1)).soles
    assert not soles.astride((left, right), config.astride)
    off = sign * 0.5 * (config.astride + config.astride_max)
    apart = structs.replace(left, **{axis: getattr(left, axis) + off}), right
    assert soles.astride(apart, config.astride) and not soles.astride(apart, config.astride_max)


def test_what_draws_a_planted_sole_is_bounded() -> None:
    """A sole that rolls over its edge at radians a second is stopped by the floor, not by the legs."""
    pose, twist, out = np.eye(4), np.array([2.0, 0.1, 0.0, 0.0, -5.0, 0.1]), np.empty(6)
    gains = ContactGains(np.full(6, 200.0), np.full(6, 28.0), np.repeat((10.0, 20.0), 3), 1.0)
    hold_contact(pose, twist, np.eye(3), np.zeros(3), gains, np.zeros(2), out)
    assert out == pytest.approx([-10.0, -2.8, 0.0, 0.0, 20.0, -2.8])
