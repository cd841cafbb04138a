"""The page's scene: meshes of every robot, moved as Pinocchio says; footsteps where they are."""

from __future__ import annotations

import math
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from models.config import default_config
from models.robot_model import RobotModel
from planners.gait.footsteps import Foothold
from tests.support import standing

viser = pytest.importorskip("viser")


@pytest.fixture
def server() -> Iterator[Any]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    made = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    yield made
    made.stop()


@pytest.mark.parametrize("name", ["g1", "talos"])
def test_every_visual_is_there_and_moves_with_its_joint(server: Any, name: str) -> None:
    from bridge.view.robot_scene import RobotScene

    model = RobotModel.load(name)
    scene = RobotScene(server.scene, model)
    assert scene.missing == [] and len(scene.frames) == model.nj + 1
    q = pin.integrate(model.pin, model.standing_configuration(), np.full(model.nv, 0.1))
    scene.show(q)
    data = model.data()
    pin.forwardKinematics(model.pin, data, q)
    for joint, frame in scene.frames.items():
        np.testing.assert_allclose(frame.position, data.oMi[joint].translation, atol=1e-12)
        w, x, y, z = frame.wxyz
        np.testing.assert_allclose(pin.Quaternion(w, x, y, z).matrix(), data.oMi[joint].rotation, atol=1e-12)


def test_balance_is_drawn_standing_and_in_the_air(server: Any, g1: RobotModel) -> None:
    from bridge.view.balance_scene import BalanceScene
    from bridge.view.config import ViewConfig
    from bridge.view.snapshot import Snapshot

    scene = BalanceScene(server.scene, g1, default_config(ViewConfig, "bridge", "view"))
    state = standing(g1)
    weight = np.array([0.0, 0.0, 0.5 * 9.81 * g1.mass, 0.0, 0.0, 0.0])
    steps = ((0, Foothold(0.3, 0.1, 0.0)), (1, Foothold(0.6, -0.1, 0.0)))
    for wrenches, there in ((np.array([weight, weight]), True), (np.zeros((2, 6)), False)):
        moment = Snapshot(
            0.0, state.q, state.v, np.zeros(g1.nj), wrenches, np.zeros(6), steps if there else (), math.nan
        )
        drawn = scene.show(moment)
        assert np.isfinite(drawn.cop).all() == there
        assert scene.balls["zmp"].visible == there
    np.testing.assert_allclose(scene.balls["com"].position, drawn.com)


def test_a_footstep_is_drawn_where_it_is() -> None:
    from bridge.view.balance_scene import outline

    corners = np.array([[0.1, 0.03, 0.0], [-0.1, 0.03, 0.0], [-0.1, -0.03, 0.0], [0.1, -0.03, 0.0]])
    drawn = outline(Foothold(1.0, 2.0, 0.5 * math.pi), corners, 0.25)
    np.testing.assert_allclose(drawn[0], [1.0 - 0.03, 2.0 + 0.1, 0.25], atol=1e-12)
