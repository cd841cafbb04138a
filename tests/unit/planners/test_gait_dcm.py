"""DCM reference: the closed forms against integration, and the recursion against what it promises."""

import math
from itertools import pairwise

import numpy as np
import pytest
from msgspec import structs

from models.robot_model import RobotModel
from planners.gait import dcm
from planners.gait.measurement import GaitMeasurement
from planners.gait.state import GaitPhase
from tests.gaits import DT, caught, in_single_support, on_one_foot
from tests.pendulum import DOUBLE, OMEGA, SINGLE, touchdown_offset
from tests.support import standing

POINTS = [np.array(p) for p in ([0.0, -0.1], [0.15, 0.1], [0.3, -0.1], [0.42, 0.1], [0.5, -0.1])]


def in_single(point: np.ndarray, end: np.ndarray, omega: float, left: float) -> tuple[np.ndarray, np.ndarray]:
    """A single support without reaction of the swing leg and with the CMP in the CoP."""
    out = np.empty((2, 2))
    dcm.pendulum(point, end, omega, left, (0.0, 0.0), (0.0, 0.0), out)
    return out[0], out[1]


def integrate(
    start: np.ndarray, old: np.ndarray, new: np.ndarray, single: float = SINGLE, steps: int = 20000
) -> np.ndarray:
    """The pendulum ``xi' = omega (xi - p)`` through one double and one single support (midpoint rule)."""
    xi, h = start.copy(), (single + DOUBLE) / steps
    for i in range(steps):
        share = min((i + 0.5) * h / DOUBLE, 1.0)
        zmp = old + share * (new - old)
        middle = xi + 0.5 * h * OMEGA * (xi - zmp)
        xi = xi + h * OMEGA * (middle - zmp)
    return xi


def test_the_recursion_leads_from_step_to_step() -> None:
    """Started at p_1 + b_1, the pendulum arrives at p_2 + b_2, and so on to the last foothold."""
    final = 0.5 * (POINTS[-1] + POINTS[-2])
    xi = POINTS[1] + touchdown_offset(POINTS, final=final)
    for i in range(1, len(POINTS) - 1):
        xi = integrate(xi, POINTS[i - 1], POINTS[i])
        expected = POINTS[i + 1] + touchdown_offset(POINTS[i:], final=final)
        assert xi == pytest.approx(expected, abs=1e-4)
    assert xi == pytest.approx(final, abs=1e-4)


def test_what_stands_at_the_end_of_the_preview_hardly_matters() -> None:
    near = touchdown_offset(POINTS, final=POINTS[-1])
    far = touchdown_offset(POINTS, final=POINTS[-1] + 0.1)
    steps = len(POINTS) - 2
    assert far - near == pytest.approx(0.1 * math.exp(-OMEGA * (SINGLE + DOUBLE) * steps))


def test_double_support_ends_at_its_end_and_its_zmp_goes_from_foot_to_foot() -> None:
    end = np.array([0.12, 0.02])
    old, new = POINTS[0], POINTS[1]
    assert dcm.double_support(old, new, end, OMEGA, DOUBLE, DOUBLE)[0] == pytest.approx(end)
    for u in np.linspace(0.0, 1.0, 9):
        xi, rate = dcm.double_support(old, new, end, OMEGA, u * DOUBLE, DOUBLE)
        zmp = xi - rate / OMEGA
        assert zmp == pytest.approx(old + u * (new - old), abs=1e-12)


@pytest.mark.parametrize("t", [0.0, 0.03, 0.07])
def test_rates_are_the_derivatives(t: float) -> None:
    h, end = 1e-6, np.array([0.2, 0.05])
    before = dcm.double_support(POINTS[0], POINTS[1], end, OMEGA, t, DOUBLE)
    after = dcm.double_support(POINTS[0], POINTS[1], end, OMEGA, t + h, DOUBLE)
    assert (after[0] - before[0]) / h == pytest.approx(before[1], abs=1e-4)
    before = in_single(POINTS[1], end, OMEGA, 0.2 - t)
    after = in_single(POINTS[1], end, OMEGA, 0.2 - t - h)
    assert (after[0] - before[0]) / h == pytest.approx(before[1], abs=1e-4)
    states = (POINTS[0], np.array([0.1, -0.2])), (POINTS[1], np.array([0.3, 0.1]))
    first = dcm.blend(*states, t + 0.1, 0.5)
    second = dcm.blend(*states, t + 0.1 + h, 0.5)
    assert (second[0] - first[0]) / h == pytest.approx(first[1], abs=1e-4)


@pytest.mark.parametrize("early", [0.0, 0.05])
@pytest.mark.parametrize("missed", [(0.0, 0.0), (-0.07, 0.01), (0.05, -0.03)])
def test_the_reference_goes_on_wherever_a_foot_comes_down(early: float, missed: tuple[float, float]) -> None:
    touchdown, new = POINTS[1] + touchdown_offset(POINTS), POINTS[1] + missed
    swinging = in_single(POINTS[0], touchdown, OMEGA, early)
    before = dcm.DcmState.at_rest(touchdown).in_single(POINTS[0], *swinging)
    landed = before.in_double(new, touchdown, OMEGA, -early, DOUBLE)
    assert landed.dcm == pytest.approx(before.dcm, abs=1e-12)
    assert landed.zmp(OMEGA) == pytest.approx(POINTS[0], abs=1e-12)
    lifting = before.in_double(new, touchdown, OMEGA, DOUBLE, DOUBLE)
    assert lifting.zmp(OMEGA) == pytest.approx(new, abs=1e-12)
    assert lifting.dcm == pytest.approx(integrate(touchdown, POINTS[0], new, 0.0), abs=1e-4)


def test_phases_join_without_a_jump_of_dcm_or_zmp() -> None:
    """Single support of the old foot -> double support -> single support of the new foot."""
    offset = touchdown_offset(POINTS)
    following = touchdown_offset(POINTS[1:])
    landing = POINTS[1] + offset
    end = in_single(POINTS[1], POINTS[2] + following, OMEGA, SINGLE)[0]
    before = in_single(POINTS[0], landing, OMEGA, 0.0)
    after = dcm.double_support(POINTS[0], POINTS[1], end, OMEGA, 0.0, DOUBLE)
    assert after[0] == pytest.approx(before[0], abs=1e-12)
    assert after[1] == pytest.approx(before[1], abs=1e-12)
    before = dcm.double_support(POINTS[0], POINTS[1], end, OMEGA, DOUBLE, DOUBLE)
    after = in_single(POINTS[1], POINTS[2] + following, OMEGA, SINGLE)
    assert after[0] == pytest.approx(before[0], abs=1e-12)
    assert after[1] == pytest.approx(before[1], abs=1e-12)


def test_a_blend_meets_both_ends() -> None:
    start, end = (np.zeros(2), np.array([0.1, 0.0])), (np.array([0.0, -0.07]), np.array([0.0, 0.15]))
    for t, state in ((0.0, start), (0.5, end)):
        value, rate = dcm.blend(start, end, t, 0.5)
        assert value == pytest.approx(state[0])
        assert rate == pytest.approx(state[1])


def test_a_late_foot_follows_the_dcm_without_a_jump(g1: RobotModel) -> None:
    """However far the DCM has run by then; the reference of foot and DCM moves on from where it is."""
    planner, planned = in_single_support(g1), []
    late_time = planner.config.swing.late_time
    while planner.state.elapsed < planner.state.step.time + 2.0 * late_time:
        state = standing(g1, planner.state.elapsed, shares=on_one_foot(planner.stance))
        if planner.state.elapsed > planner.state.step.time - 5 * DT:
            state.v[:3] = 0.5, 0.0, 0.0  # and so the DCM, by more than 0.1 m
        planned.append((planner.step(state, DT).dcm.copy(), planner.state.swing.position[:2].copy()))
    assert planner.phase is GaitPhase.SINGLE
    late = round(2.0 * late_time / DT)
    dcm_speed, foot_speed = np.abs(np.diff(planned[-late:], axis=0)).max(axis=(0, 2)) / DT
    assert dcm_speed < 5.0 and foot_speed < 4.0


def test_a_foot_that_stays_caught_is_late_after_the_longest_step(g1: RobotModel) -> None:
    planner = in_single_support(g1)
    while planner.state.elapsed < planner.state.step.time:
        planner.step(caught(planner), DT)
    assert planner.trips > 1
    assert planner.state.elapsed < planner.config.timing.single_max + 2 * DT


def test_a_sudden_transfer_counts_in_full() -> None:
    assert dcm.transfer_share(OMEGA, 0.0) == 1.0
    assert dcm.transfer_share(OMEGA, 1e-6) == pytest.approx(1.0, abs=1e-5)


def test_the_reference_rests_while_a_foot_is_late(g1: RobotModel) -> None:
    planner, rates = in_single_support(g1), []
    late_time = planner.config.swing.late_time
    while planner.state.elapsed < planner.state.step.time + late_time + 2 * DT:
        state = standing(g1, planner.state.elapsed, shares=on_one_foot(planner.stance))
        left = planner.state.step.time - planner.state.elapsed
        rates.append((left, float(np.linalg.norm(planner.step(state, DT).dcm_velocity))))
    assert planner.phase is GaitPhase.SINGLE
    assert min(rate for left, rate in rates if left > 0.0) > 0.02
    assert rates[-1][1] == 0.0
    fading = [rate for left, rate in rates if -late_time < left < 0.0]
    assert all(after < before for before, after in pairwise(fading))


@pytest.mark.parametrize("urgent", [True, False])
def test_after_an_urgent_step_that_did_not_catch_the_robot_the_next_one_is_urgent_at_once(
    g1: RobotModel, urgent: bool
) -> None:
    """The DCM is at the reference, which continues the plan of the last step, but far from where a step begins."""
    planner = in_single_support(g1)
    gait, state = planner.state, standing(g1)
    state.v[0] = -0.6
    gait.phase, gait.stance, gait.elapsed = GaitPhase.DOUBLE, 1 - gait.stance, 0.0
    reached = GaitMeasurement(g1).measure(state).dcm(gait.omega)
    gait.step = structs.replace(gait.step, urgent=urgent, touchdown=reached, double=0.1)
    planner.step(state, DT)
    assert gait.dcm_error < planner.config.adjustment.urgent
    assert (gait.phase is GaitPhase.SINGLE and gait.step.urgent) is urgent
