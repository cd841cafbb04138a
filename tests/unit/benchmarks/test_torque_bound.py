"""The bound of torques and soles: without torque limits it is that of the pendulum, with small ones it is theirs."""

import math

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.stability.push_bounds import ankle_bound, static_force, torque_bound
from bridge.analysis.stability import distance_along, support_polygon
from models.constants import GRAVITY
from models.errors import PoiseError
from models.robot_model import RobotModel

NONE = np.inf


def pendulum(model: RobotModel, q: np.ndarray, direction: np.ndarray) -> tuple[float, float]:
    """Height of the CoM above the soles, and its distance to the edge of the support in a direction [m]."""
    data = model.data()
    com = np.array(pin.centerOfMass(model.pin, data, q))
    pin.framesForwardKinematics(model.pin, data, q)
    places = [data.oMf[foot.frame_id] for foot in model.feet]
    corners = [
        place.translation + foot.corners @ place.rotation.T for foot, place in zip(model.feet, places, strict=True)
    ]
    sole = float(places[0].translation[2])
    return float(com[2]) - sole, distance_along(support_polygon(corners), com[:2], direction)


@pytest.mark.parametrize("name", ["g1", "talos"])
@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0, math.pi, 5.0])
def test_without_torque_limits_it_is_the_ankle_bound(name: str, angle: float) -> None:
    model = RobotModel.load(name)
    q = model.standing_configuration()
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    height, distance = pendulum(model, q, direction)
    force = static_force(model, q, direction, np.full(model.nj, NONE))
    assert force == pytest.approx(model.mass * GRAVITY * distance / height, rel=1e-3)
    ankle = ankle_bound(model.mass, height, distance, 0.1)
    assert torque_bound(model, q, direction, 0.1) <= ankle * 1.001


def test_weaker_ankles_bear_less_and_none_bear_nothing() -> None:
    model = RobotModel.load("g1")
    q = model.standing_configuration()
    forward = np.array([1.0, 0.0, 0.0])
    whole = static_force(model, q, forward, model.tau_max)
    last = whole
    for share in (0.4, 0.2):
        weak = model.tau_max.copy()
        for i, name in enumerate(model.joint_names):
            if "ankle" in name:
                weak[i] *= share
        force = static_force(model, q, forward, weak)
        assert force < last
        last = force
    assert last < 0.5 * whole
    with pytest.raises(PoiseError, match="cannot stand"):
        static_force(model, q, forward, np.full(model.nj, 0.01))


def test_static_torques_keep_the_base_in_balance() -> None:
    model = RobotModel.load("talos")
    torques = model.static_torques(model.standing_configuration(), model.data())
    assert torques.shape == (model.nj,)
    assert (np.abs(torques) < model.tau_max).all() and np.abs(torques).max() > 1.0
