"""Reaction of the swing leg: its size against Pinocchio, its closed form against an integrated swing."""

import math

import numpy as np
import pinocchio as pin
import pytest

from models.config import default_config
from models.constants import GRAVITY
from models.errors import RobotModelError
from models.numerics.unboxed import unbox
from models.robot_model import RobotModel
from planners.gait.config import GaitConfig
from planners.gait.dcm import single_support
from planners.gait.pace import Pace
from planners.gait.reaction import LegLever, SwingLeg, leg_lever, swing_slope, whole_swing
from planners.gait.swing import SwingFoot
from tests.pendulum import DOUBLE, OMEGA, SINGLE, touchdown_offset

CONFIG = default_config(GaitConfig, "planners", "gait").swing
DT = 0.001
PACE = Pace(SINGLE, DOUBLE, crouch=0.0, clearance=0.05, share=0.0, least_effort=0.5)
FOOT = SwingFoot(CONFIG)
LEVER = LegLever(lever=0.0042, slope=-0.009, lift=0.004, side=0.004)
SWING_LEG = SwingLeg(FOOT.shape, LEVER)
LEG = unbox(SWING_LEG)


@pytest.mark.parametrize(("name", "hip_pitch"), [("g1", 0), ("talos", 2)])
@pytest.mark.parametrize("swing", [-0.3, 0.0, 0.3])
def test_the_levers_give_the_momentum_of_a_moving_foot(name: str, hip_pitch: int, swing: float) -> None:
    """A foot of a bent leg that is moved alone, behind, below and ahead of the hip, in each direction."""
    model = RobotModel.load(name)
    data, q, foot = model.data(), model.standing_configuration(), model.feet[0]
    leg = np.array(foot.joint_ids_v)
    for joint, angle in ((hip_pitch, -0.3 - swing), (3, 0.6), (4, swing - 0.3)):
        q[leg[joint] + 1] += angle
    pin.computeJointJacobians(model.pin, data, q)
    pin.centerOfMass(model.pin, data, q)
    jacobian = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.LOCAL_WORLD_ALIGNED).copy()
    ahead = pin.updateFramePlacement(model.pin, data, foot.frame_id).translation[0] - data.com[0][0]
    lever = leg_lever(model)
    weight = model.mass * GRAVITY
    forward = lever.lever + lever.slope * ahead
    # The knee's angle changes what a lifted foot takes by half: one number stands for all of a swing.
    for axis, component, expected, off in (
        (0, 1, -forward, 0.001),
        (2, 1, -lever.lift, 0.003),
        (1, 0, lever.side, 0.001),
    ):
        v = np.zeros(model.nv)
        v[leg] = np.linalg.solve(jacobian[:, leg], np.eye(6)[axis])
        momentum = pin.computeCentroidalMomentum(model.pin, data, q, v).angular[component] / weight
        assert momentum == pytest.approx(expected, abs=off)
    assert lever.slope < -0.004  # a trailing leg has more


def test_a_leg_that_cannot_get_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("planners.gait.reaction._REACH", 2.0)
    with pytest.raises(RobotModelError, match="left foot cannot be moved"):
        leg_lever(RobotModel.load("g1"))


def swing_cmps(way: np.ndarray, yaw: float = 0.0) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """CMP of each tick of a swing, and the allowance of the DCM before it; the CoP is at the origin."""
    c, s = math.cos(yaw), math.sin(yaw)
    velocity = 0.5 / PACE.period * way
    pose, ends = np.array([0.0, 0.0, 0.0, yaw]), (way[0], way[1])
    foot = FOOT.lift(pose, PACE.clearance, SINGLE, np.zeros(2), target=ends, effort=PACE.least_effort)
    start = 0.5 * (way - velocity * SINGLE)
    target = np.array([*way, 0.0, yaw])
    cmps, rests = [], []

    def reaction(left: float) -> tuple[np.ndarray, np.ndarray]:
        swing = foot.towards(*ends)
        still, out = np.zeros(2), np.empty((3, 2))
        single_support(still, still, OMEGA, left, swing, (com, velocity), LEG, out)
        return out[0], out[2]

    for i in range(round(SINGLE / DT)):
        com = start + velocity * i * DT
        rests.append(reaction(SINGLE - i * DT)[0])
        foot = FOOT.step(foot, target, np.zeros(2), (i + 1) * DT, SINGLE, DT, effort=PACE.least_effort)
        cmps.append(reaction(SINGLE - i * DT)[1])
    turn = np.array([[c, s], [-s, c]])  # into the heading
    return [turn @ cmp for cmp in cmps], [turn @ rest for rest in rests]


@pytest.mark.parametrize("begin", [0, 100, 200, 280])
def test_what_the_rest_of_a_swing_uses_up(begin: int) -> None:
    """A DCM that allows for it ends over the CoP; one that does not is centimetres off at the nominal step."""
    cmps, rests = swing_cmps(np.array([0.6, -0.1]))
    xi = rests[begin].copy()
    for cmp in cmps[begin:]:
        xi += math.expm1(OMEGA * DT) * (xi - cmp)
    assert xi == pytest.approx(np.zeros(2), abs=0.003)
    assert np.linalg.norm(rests[0]) > 0.015


def test_a_step_on_the_spot_pushes_forward_too() -> None:
    """The knee of a lifted foot comes forward, and goes back later."""
    cmps, _ = swing_cmps(np.zeros(2))
    assert cmps[40][0] < -0.03 < 0.02 < cmps[140][0]


def test_the_heading_turns_it() -> None:
    straight, turned = swing_cmps(np.array([0.4, 0.1])), swing_cmps(_turned(np.array([0.4, 0.1]), 0.7), 0.7)
    for here, there in zip(straight, turned, strict=True):
        np.testing.assert_allclose(there, here, atol=1e-9)


def _turned(vector: np.ndarray, yaw: float) -> np.ndarray:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s], [s, c]]) @ vector


def test_the_recursion_allows_for_the_swing_of_every_step() -> None:
    points = [np.array(p) for p in ([0.0, -0.1], [0.3, 0.1], [0.6, -0.1], [0.9, 0.1])]
    way = points[2] - points[0]
    swing = whole_swing(OMEGA, PACE, (way[0], way[1]), 0.0, SWING_LEG)
    offset = touchdown_offset(points, swing)
    xi = points[1] + offset
    ticks = round(DOUBLE / DT)
    for i in range(ticks):
        zmp = points[0] + (i + 0.5) / ticks * (points[1] - points[0])
        xi = xi + math.expm1(OMEGA * DT) * (xi - zmp)
    cmps, _ = swing_cmps(way)
    for cmp in cmps:
        xi = xi + math.expm1(OMEGA * DT) * (xi - points[1] - cmp)
    expected = points[2] + touchdown_offset(points[1:], swing)
    assert xi == pytest.approx(expected, abs=0.003)
    unaware = points[1] + touchdown_offset(points)
    assert np.linalg.norm(unaware - points[1] - offset) > 0.01


def test_a_longer_way_uses_up_more() -> None:
    short, long = (whole_swing(OMEGA, PACE, (x, 0.0), 0.0, SWING_LEG)[0] for x in (0.3, 0.5))
    assert (long - short) / 0.2 == pytest.approx(swing_slope(OMEGA, SINGLE, LEVER), rel=0.5)
    assert long < short < 0.0
