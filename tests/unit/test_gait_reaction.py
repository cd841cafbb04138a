"""Reaction of the swing leg: its size against Pinocchio, its closed form against an integrated swing."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from models.config import default_config
from models.constants import GRAVITY
from models.robot_model import RobotModel
from planners.gait import dcm
from planners.gait.config import GaitConfig
from planners.gait.reaction import SwingReaction, leg_lever
from planners.gait.swing import SwingFoot

CONFIG = default_config(GaitConfig, "planners", "gait").swing
OMEGA, SINGLE, DOUBLE, DT = 3.85, 0.34, 0.08, 0.001
LEVER = 0.0045


@pytest.mark.parametrize("name", ["g1", "talos"])
def test_the_lever_is_the_momentum_of_a_moving_foot(name: str) -> None:
    """A foot moved ahead alone takes ``-lambda m g`` of pitch momentum per m/s, moved to the left as much of roll."""
    model = RobotModel.load(name)
    data, q = model.data(), model.standing_configuration()
    pin.computeJointJacobians(model.pin, data, q)
    foot = model.feet[0]
    jacobian = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.LOCAL_WORLD_ALIGNED).copy()
    expected = leg_lever(model) * model.mass * GRAVITY
    for axis, component, sign in ((0, 1, -1.0), (1, 0, 1.0)):
        v = np.zeros(model.nv)
        twist = np.eye(6)[axis]
        v[list(foot.joint_ids_v)] = np.linalg.lstsq(jacobian[:, list(foot.joint_ids_v)], twist, rcond=None)[0]
        momentum = pin.computeCentroidalMomentum(model.pin, data, q, v).angular
        assert sign * momentum[component] == pytest.approx(expected, rel=0.1)


def swing_zmps(reaction: SwingReaction, way: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Planned ZMP of each tick of a swing, and what the DCM must allow for before it; the CoP is at the origin."""
    foot = SwingFoot(CONFIG)
    foot.lift(np.zeros(4))
    target = np.array([*way, 0.0, 0.0])
    zmps, rests = [], []
    ticks = round(SINGLE / DT)
    for i in range(ticks):
        rests.append(reaction.rest(OMEGA, SINGLE - i * DT, foot.way(*way), foot.velocity[:2]))
        foot.step(target, (i + 1) * DT, SINGLE, DT)
        zmps.append(reaction.zmp(foot.acceleration[:2]))
    return zmps, rests


@pytest.mark.parametrize("begin", [0, 100, 200, 280])
def test_what_the_rest_of_a_swing_uses_up(begin: int) -> None:
    """A DCM that allows for it ends over the CoP; one that does not is centimetres off at the nominal step."""
    reaction = SwingReaction(LEVER, 1.0)
    way = np.array([0.6, -0.1])
    zmps, rests = swing_zmps(reaction, way)
    xi = rests[begin].copy()
    for zmp in zmps[begin:]:
        xi += math.expm1(OMEGA * DT) * (xi - zmp)
    assert xi == pytest.approx(np.zeros(2), abs=0.006)
    assert np.linalg.norm(rests[0]) > 0.015


def test_the_recursion_allows_for_the_swing_of_every_step() -> None:
    reaction = SwingReaction(LEVER, 1.0)
    points = [np.array(p) for p in ([0.0, -0.1], [0.3, 0.1], [0.6, -0.1], [0.9, 0.1])]
    per_metre = reaction.whole_swing(OMEGA, SINGLE)
    offset = dcm.touchdown_offset(points, OMEGA, SINGLE, DOUBLE, None, per_metre)
    xi = points[1] + offset
    ticks = round(DOUBLE / DT)
    for i in range(ticks):
        zmp = points[0] + (i + 0.5) / ticks * (points[1] - points[0])
        xi = xi + math.expm1(OMEGA * DT) * (xi - zmp)
    zmps, _ = swing_zmps(reaction, points[2] - points[0])
    for zmp in zmps:
        xi = xi + math.expm1(OMEGA * DT) * (xi - points[1] - zmp)
    wanted = points[2] + dcm.touchdown_offset(points[1:], OMEGA, SINGLE, DOUBLE, None, per_metre)
    assert xi == pytest.approx(wanted, abs=0.006)
    unaware = points[1] + dcm.touchdown_offset(points, OMEGA, SINGLE, DOUBLE)
    assert np.linalg.norm(unaware - points[1] - offset) > 0.01


def test_the_share_scales_the_plan_but_not_the_true_offset() -> None:
    acceleration = np.array([10.0, -4.0])
    half = SwingReaction(LEVER, 0.5)
    assert half.zmp(acceleration) == pytest.approx(-0.5 * LEVER * acceleration)
    assert half.cmp_offset(acceleration) == pytest.approx(-LEVER * acceleration)
    assert SwingReaction(LEVER, 0.0).whole_swing(OMEGA, SINGLE) == 0.0
