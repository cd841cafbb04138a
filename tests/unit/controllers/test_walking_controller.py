"""The balance law in single support: the CMP stays where the stance sole, shifted by the reaction, can give it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from msgspec import structs

from benchmarks.stability.humanoids import Humanoid
from controllers.balance.controller import BalanceController
from controllers.whole_body.config import WholeBodyConfig
from models.config import default_config
from models.constants import GRAVITY
from models.proposal.profile_text import write_proposal
from models.proposal.propose import propose
from models.robot_model import RobotModel
from models.types import ContactState, Reference, RobotState
from planners.gait.planner import GaitPlanner
from tests.support import standing


@pytest.fixture(scope="module")
def case() -> tuple[BalanceController, RobotState, Reference]:
    """On the left foot, with a DCM reference so far ahead that the CMP is at the heel."""
    model = RobotModel.load("g1")
    state, planner = standing(model), GaitPlanner(model)
    planner.reset(state)
    reference = planner.step(state, 0.001)
    assert reference.dcm is not None
    ahead = structs.replace(
        reference, contacts=(True, False), load=(1.0, 0.0), dcm=reference.dcm + np.array([1.0, 0.0])
    )
    controller = BalanceController(model)
    controller.reset(state)
    return controller, state, ahead


def cmp_at(case: tuple[BalanceController, RobotState, Reference], offset: np.ndarray | None) -> np.ndarray:
    controller, state, reference = case
    zmp = controller.track(state, structs.replace(reference, cmp_offset=offset)).zmp
    assert zmp is not None
    return zmp


def test_the_cmp_is_kept_inside_the_stance_sole(case: tuple[BalanceController, RobotState, Reference]) -> None:
    heel = case[0].model.feet[0].rectangle[0]
    assert cmp_at(case, None)[0] == pytest.approx(heel, abs=1e-6)


def test_angular_momentum_takes_the_cmp_beyond_the_edge_as_far_as_its_share_allows(
    case: tuple[BalanceController, RobotState, Reference],
) -> None:
    """The DCM, in the middle between the soles, is to the right of the left one, which bears."""
    controller, state, reference = case
    reach = controller.config.stepping.momentum_reach_max
    left = structs.replace(reference, dcm=controller.whole_body.terms.com[:2].copy())
    edge, half, whole = (
        controller.track(state, structs.replace(left, momentum=share)).zmp for share in (0.0, 0.5, 1.0)
    )
    assert edge is not None and half is not None and whole is not None
    assert half - edge == pytest.approx([0.0, -0.5 * reach], abs=1e-3)
    assert whole - edge == pytest.approx([0.0, -reach], abs=1e-3)


def test_the_reaction_shifts_where_it_may_be(case: tuple[BalanceController, RobotState, Reference]) -> None:
    without = cmp_at(case, None)
    assert cmp_at(case, np.array([-0.1, 0.02])) - without == pytest.approx([-0.1, 0.02], abs=1e-6)


def test_the_shift_is_bounded(case: tuple[BalanceController, RobotState, Reference]) -> None:
    reach = case[0].config.reaction_reach_max
    without = cmp_at(case, None)
    assert cmp_at(case, np.array([-10.0, 0.0]))[0] - without[0] == pytest.approx(-reach, abs=1e-6)


def test_a_rise_of_the_com_takes_a_force_through_the_cmp(
    case: tuple[BalanceController, RobotState, Reference],
) -> None:
    controller, state, reference = case
    found = []
    for rise in (0.0, 2.0):
        controller.track(state, structs.replace(reference, com_acceleration=np.array([0.0, 0.0, rise])))
        override = controller.whole_body.com_task.override
        assert override is not None
        found.append(override.copy())
    level, risen = found
    assert risen[2] - level[2] == pytest.approx(2.0)
    assert risen[:2] == pytest.approx((1.0 + 2.0 / GRAVITY) * level[:2])


def test_the_force_passes_through_the_zmp_at_its_height(case: tuple[BalanceController, RobotState, Reference]) -> None:
    controller, state, reference = case
    height = controller.whole_body.terms.com[2] - reference.sole_positions[0, 2]
    for under, pressed in ((0.0, 0.0), (0.05, 0.0), (0.08, 0.1)):
        controller.track(state, structs.replace(reference, levels=(under, pressed)))
        override, away = controller.whole_body.com_task.override, controller.whole_body.terms.com[:2]
        assert override is not None
        assert override[:2] == pytest.approx(GRAVITY / (height - pressed) * (away - controller._arrays.cmp))


def acceleration(swing: Reference, state: RobotState, **changes: object) -> np.ndarray:
    """What the controller makes of a reference, with some of its settings changed."""
    whole_body = default_config(WholeBodyConfig, "controllers", "whole_body")
    controller = BalanceController(RobotModel.load("g1"), whole_body=replace(whole_body, **changes))  # type: ignore[arg-type]
    controller.reset(state)
    result = controller.track(state, swing)
    assert result.acceleration is not None
    return result.acceleration


def momentum_rate(case: tuple[BalanceController, RobotState, Reference], weight: float) -> float:
    """Angular momentum about the vertical that a leg swung forward takes in a second [N.m]."""
    controller, state, ahead = case
    accelerations = np.zeros((2, 6))
    accelerations[1, 0] = 20.0
    gains = replace(controller.whole_body.config.stepping, momentum_weight_vertical=weight)
    swing = structs.replace(ahead, sole_accelerations=accelerations)
    a = acceleration(swing, state, stepping=gains)
    terms = controller.whole_body.terms
    return float((terms.momentum_matrix @ a + terms.momentum_drift)[2])


def test_arms_and_torso_swing_against_the_leg(case: tuple[BalanceController, RobotState, Reference]) -> None:
    alone, against = momentum_rate(case, 0.0), momentum_rate(case, 40000.0)
    assert abs(alone) > 4.0
    assert abs(against) < 0.7 * abs(alone)


def with_leg(
    controller: BalanceController, state: RobotState, joints: tuple[tuple[int, float, float], ...], *, at: int, q: float
) -> RobotState:
    """The right leg elsewhere: joints by their number with angle added and rate, one of them put to an angle."""
    leg, angles, rates = controller.model.feet[1].joint_ids_v, state.q.copy(), state.v.copy()
    for joint, angle, rate in joints:
        angles[leg[joint] + 1] += angle
        rates[leg[joint]] = rate
    angles[leg[at] + 1] = q
    near = structs.replace(state, q=angles, v=rates)
    controller.whole_body.terms.update(near)
    return near


def test_a_foot_tips_rather_than_the_body_where_its_ankle_is_at_a_limit(
    case: tuple[BalanceController, RobotState, Reference],
) -> None:
    """In a lift-off: the knee bends faster than the ankle can follow."""
    controller, state, ahead = case
    low = controller.model.q_lower[controller.model.feet[1].joint_ids_v[4] - 6]
    near = with_leg(controller, state, ((0, -0.25, -1.5), (3, 0.6, 3.0), (4, 0.0, -1.5)), at=4, q=low + 0.06)
    sole = controller.whole_body.terms.soles[1]
    velocities, positions, rotations = np.zeros((2, 6)), ahead.sole_positions.copy(), ahead.sole_rotations.copy()
    velocities[1] = (sole.rotation @ sole.twist.reshape(2, 3).T).T.ravel()
    positions[1], rotations[1] = sole.pose[:3, 3], sole.rotation
    lifting = structs.replace(ahead, sole_velocities=velocities, sole_positions=positions, sole_rotations=rotations)
    tilts = [abs(acceleration(lifting, near, foot_pitch_scale=scale)[3:6]).max() for scale in (1.0, 0.005)]
    assert tilts[1] < 0.5 * tilts[0]


def test_a_foot_rolls_rather_than_fall_short_where_its_ankle_is_at_a_limit(
    case: tuple[BalanceController, RobotState, Reference],
) -> None:
    """In a wide step: the leg moves out, and the ankle cannot keep the sole level any more."""
    controller, state, ahead = case
    high = controller.model.q_upper[controller.model.feet[1].joint_ids_v[5] - 6]
    near = with_leg(controller, state, ((1, -0.3, -2.0), (5, 0.0, 1.0)), at=5, q=high - 0.03)
    sole = controller.whole_body.terms.soles[1]
    velocities, positions = np.zeros((2, 6)), ahead.sole_positions.copy()
    positions[1] = sole.position + np.array([0.0, -0.1, 0.0])
    velocities[1, 1] = -2.0
    wide = structs.replace(ahead, sole_velocities=velocities, sole_positions=positions)
    jacobian, drift = sole.jacobian.copy(), sole.drift.copy()
    out = [-(jacobian @ acceleration(wide, near, foot_roll_scale=scale) + drift)[1] for scale in (1.0, 0.05)]
    assert out[1] > out[0] + 5.0  # [m/s^2]


def test_the_cmp_is_kept_inside_what_bears_of_the_sole(case: tuple[BalanceController, RobotState, Reference]) -> None:
    controller, state, reference = case
    areas = np.array([foot.rectangle for foot in controller.model.feet])
    areas[0, :2] = 0.02, 0.05  # of the stance sole, only a strip across its middle bears
    result = controller.track(state, structs.replace(reference, cmp_offset=None, sole_areas=areas))
    assert result.zmp is not None and result.wrenches is not None
    heel = controller.model.feet[0].rectangle[0]
    assert result.zmp[0] - cmp_at(case, None)[0] == pytest.approx(0.02 - heel, abs=1e-6)
    cop = -result.wrenches[0, 4] / result.wrenches[0, 2]
    assert 0.02 - 1e-6 <= cop <= 0.05 + 1e-6
    whole = controller.track(state, structs.replace(reference, cmp_offset=None, sole_areas=None))
    assert whole.wrenches is not None and whole.zmp is not None
    assert -whole.wrenches[0, 4] / whole.wrenches[0, 2] < 0.02
    assert whole.zmp[0] - result.zmp[0] == pytest.approx(heel - 0.02, abs=1e-6)


def test_a_sole_is_loaded_in_the_middle_of_what_bears(case: tuple[BalanceController, RobotState, Reference]) -> None:
    controller, state, reference = case
    areas = np.array([(0.02, 0.06, -0.02, 0.0), (-0.04, 0.0, 0.01, 0.02)])
    controller.track(state, structs.replace(reference, contacts=(True, True), load=(0.5, 0.5), sole_areas=areas))
    target = controller.whole_body.wrench_target
    for foot in range(2):
        x_min, x_max, y_min, y_max = areas[foot]
        cop = np.array([-target[foot, 4], target[foot, 3]]) / target[foot, 2]
        np.testing.assert_allclose(cop, [0.5 * (x_min + x_max), 0.5 * (y_min + y_max)])


@pytest.mark.parametrize("ankle_roll", [True, False])
def test_a_drift_of_the_estimate_does_not_move_a_standing_robot(ankle_roll: bool, tmp_path: Path) -> None:
    """A new heading of an estimate 5 m from its origin moves robot and soles in W, and the commanded CMP as much.

    Soles without ankle roll, which turn with their legs, are no exception: a robot with them crept aside after a walk.
    """
    proposal = propose(Humanoid(ankle_roll=ankle_roll).write(tmp_path))
    model = RobotModel.load(write_proposal(proposal, tmp_path / "mine.yaml")[0])
    foot = ContactState(True, np.array([0.0, 0.0, 0.5 * model.mass * GRAVITY, 0.0, 0.0, 0.0]))
    state = structs.replace(standing(model), contacts=(foot, foot))
    controller = BalanceController(model)
    controller.reset(state)
    before = controller.step(state, 0.001)
    drift = pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.01])), np.array([0.02, 0.03, 0.0]))
    drift = pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0])) * drift * pin.SE3(np.eye(3), np.array([-5.0, 0.0, 0.0]))
    q = state.q.copy()
    q[:7] = pin.SE3ToXYZQUAT(drift * pin.XYZQUATToSE3(q[:7]))
    after = controller.step(structs.replace(state, q=q), 0.001)
    assert after.zmp == pytest.approx((drift * np.array([*before.zmp, 0.0]))[:2], abs=1e-5)
    assert after.command.tau == pytest.approx(before.command.tau, abs=0.05)
