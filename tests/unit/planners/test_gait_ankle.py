"""A stance ankle at its limit: the edge that the sole turns over follows from the robot's kinematics."""

import math

import numpy as np
import pinocchio as pin
import pytest

from models.robot_model import RobotModel
from models.types import ContactState, RobotState, Vector
from planners.gait.ankle import AnkleStops
from planners.gait.scaling import load_gait_config

LEANS = {"left": (-1, 0), "right": (1, 0), "front": (0, 1), "back": (0, -1)}  # rotation of the body about x and y


@pytest.fixture(scope="module", params=["g1", "talos"])
def model(request: pytest.FixtureRequest) -> RobotModel:
    return RobotModel.load(request.param)


def state_at(q: Vector, v: Vector) -> RobotState:
    contact = ContactState(True, np.zeros(6))
    return RobotState(0.0, q, v, np.zeros(len(v) - 6), (contact, contact))


def corner_heights(model: RobotModel, q: Vector, foot: int) -> Vector:
    """Heights of the corners of a sole in W (4,) [m]."""
    data = model.data()
    pin.forwardKinematics(model.pin, data, q)
    sole = pin.updateFramePlacement(model.pin, data, model.feet[foot].frame_id)
    return np.array([sole.act(corner)[2] for corner in model.feet[foot].corners])


def at_limit(model: RobotModel, foot: int, lean: str) -> tuple[RobotState, int, Vector]:
    """A robot with the ankle joint at the limit that a lean comes to, that joint, and the lowest corners of its sole.

    The joint is the one that levels the sole best while the body leans; the sole turns with the body from its limit on.
    """
    standing = model.standing_configuration()
    leaning = standing.copy()
    turn = pin.exp3(0.1 * np.array([*LEANS[lean], 0.0]))
    leaning[3:7] = pin.Quaternion(turn).coeffs()
    lowest = corner_heights(model, leaning, foot)
    found: list[tuple[float, int, float]] = []
    for column in model.feet[foot].joint_ids_v[-2:]:
        for step in (0.1, -0.1):
            levelled = leaning.copy()
            levelled[column + 1] += step
            found.append((float(np.ptp(corner_heights(model, levelled, foot))), column - 6, step))
    _, joint, step = min(found)
    q = standing.copy()
    q[7 + joint] = model.q_upper[joint] if step > 0.0 else model.q_lower[joint]
    return state_at(q, np.zeros(model.nv)), joint, lowest <= np.median(lowest)


@pytest.mark.parametrize("foot", [0, 1])
@pytest.mark.parametrize("lean", LEANS)
def test_the_sole_turns_over_the_edge_that_the_leg_leans_over(model: RobotModel, foot: int, lean: str) -> None:
    stops, whole = AnkleStops(model, load_gait_config(model).ankle), np.array([each.rectangle for each in model.feet])
    state, joint, lowest = at_limit(model, foot, lean)
    edge = model.feet[foot].corners[lowest].mean(axis=0)[:2]
    area = stops.on_edge(foot, state, edge, whole)
    axis = 1 if lean in ("left", "right") else 0
    assert area[foot, 2 * axis] == area[foot, 2 * axis + 1] == pytest.approx(edge[axis])
    other = 2 * (1 - axis)
    assert np.array_equal(area[foot, other : other + 2], whole[foot, other : other + 2])
    assert np.array_equal(area[1 - foot], whole[1 - foot])

    away = state.v.copy()
    away[6 + joint] = -10.0 * math.copysign(1.0, state.q[7 + joint])  # leaves the limit again
    assert np.array_equal(stops.on_edge(foot, state_at(state.q, away), edge, whole), whole)
    assert np.array_equal(stops.on_edge(foot, state, 0.5 * edge, whole), whole)  # centre of pressure inside


def test_a_joint_that_moves_towards_its_limit_counts_early(model: RobotModel) -> None:
    config = load_gait_config(model).ankle
    stops, whole = AnkleStops(model, config), np.array([each.rectangle for each in model.feet])
    state, joint, lowest = at_limit(model, 1, "left")
    edge = model.feet[1].corners[lowest].mean(axis=0)[:2]
    q, v, towards = state.q.copy(), state.v.copy(), math.copysign(1.0, state.q[7 + joint])
    q[7 + joint] -= towards * (config.stop_margin + 0.05)
    for speed, edged in ((0.9 * 0.05 / config.stop_time, False), (1.1 * 0.05 / config.stop_time, True)):
        v[6 + joint] = towards * speed
        assert np.array_equal(stops.on_edge(1, state_at(q, v), edge, whole), whole) is not edged
