"""The page's scene: meshes of every robot, moved as Pinocchio says; footsteps where they are."""

import json
import math
import re
import socket
from collections.abc import Iterator
from types import SimpleNamespace
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
    from bridge.view.scene import RobotScene

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
    from bridge.view.listener import Snapshot, ViewConfig
    from bridge.view.scene import DOT, BalanceScene, RobotScene

    scene = BalanceScene(server.scene, g1, default_config(ViewConfig, "bridge", "view"))
    state, robot = standing(g1), RobotScene(server.scene, g1)
    robot.show(state.q)
    weight = np.array([0.0, 0.0, 0.5 * 9.81 * g1.mass, 0.0, 0.0, 0.0])
    steps = ((0, Foothold(0.3, 0.1, 0.0)), (1, Foothold(0.6, -0.1, 0.0)))
    for wrenches, there in ((np.array([weight, weight]), True), (np.zeros((2, 6)), False)):
        moment = Snapshot(
            0.0, state.q, state.v, np.zeros(g1.nj), wrenches, np.zeros(6), steps if there else (), math.nan
        )
        drawn = scene.show(moment)
        assert np.isfinite(drawn.cop).all() == there
        assert scene.balls["zmp"].visible == there
        text = re.search("data-state='(.*)'", scene.flat(robot, moment, drawn))
        assert text is not None
        lines = np.array(json.loads(text[1])["lines"])
        assert lines.shape[1] == 10 and np.isfinite(lines).all()
        dots = lines[lines[:, 6] == DOT, :3]
        assert len(dots) == (3 if there else 2) and len(lines) > g1.nj
        np.testing.assert_allclose(dots[0], drawn.com, atol=1e-3)
        np.testing.assert_allclose(lines[:, 2].min(), 0.0, atol=0.05)  # the soles
    np.testing.assert_allclose(scene.balls["com"].position, drawn.com)


def test_ground_reactions_point_as_the_soles_do(server: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    from bridge.view.listener import Snapshot, ViewConfig
    from bridge.view.scene import BalanceScene

    config, state = default_config(ViewConfig, "bridge", "view"), standing(g1)
    q = state.q.copy()
    q[3:7] = 0.0, 0.0, math.sin(0.25 * math.pi), math.cos(0.25 * math.pi)  # turned by a right angle to the left
    wrenches = np.zeros((2, 6))
    wrenches[0, :3] = 30.0, 0.0, 200.0  # forward and up, in the sole's frame
    drawn: list[Any] = []
    monkeypatch.setattr(server.scene, "add_arrows", lambda name, points, colors: drawn.append(points))
    push = np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    moment = Snapshot(0.0, q, state.v, np.zeros(g1.nj), wrenches, push, (), math.nan)
    BalanceScene(server.scene, g1, config).show(moment)
    reaction, pushed = drawn[0][:, 1] - drawn[0][:, 0]
    np.testing.assert_allclose(reaction, config.force_scale * np.array([0.0, 30.0, 200.0]), atol=1e-6)
    np.testing.assert_allclose(pushed, config.force_scale * push[:3], atol=1e-6)


def test_he_who_steers_is_there_while_he_moves_something_and_his_browser_is() -> None:
    from bridge.view.controls import DeadMan

    man = DeadMan(10.0)
    assert not man.present([1, 2], 0.0)  # no stick was moved yet
    man.touch(1, 5.0)
    assert man.present([1, 2], 15.0) and not man.present([1, 2], 15.1)
    man.touch(1, 20.0)
    assert not man.present([2], 20.0)  # another browser that only looks does not hold the sticks


def test_a_push_comes_from_the_robots_side_wherever_it_looks() -> None:
    from bridge.view.controls import DIRECTIONS, force_from

    turned = 0.5 * math.pi  # it looks to +y, so its left is -x
    np.testing.assert_allclose(force_from(10.0, DIRECTIONS["from behind"], turned), [0.0, 10.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(force_from(10.0, DIRECTIONS["from the left"], turned), [10.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(force_from(10.0, DIRECTIONS["from the left"], 0.0), [0.0, -10.0, 0.0], atol=1e-12)


def test_a_footstep_is_drawn_where_it_is() -> None:
    from bridge.view.scene import outline

    corners = np.array([[0.1, 0.03, 0.0], [-0.1, 0.03, 0.0], [-0.1, -0.03, 0.0], [0.1, -0.03, 0.0]])
    drawn = outline(Foothold(1.0, 2.0, 0.5 * math.pi), corners, 0.25)
    np.testing.assert_allclose(drawn[0], [1.0 - 0.03, 2.0 + 0.1, 0.25], atol=1e-12)


def test_plots_take_new_data_alone(server: Any, g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    from bridge.view.controls import LivePlots
    from bridge.view.listener import Snapshot, ViewConfig, Words

    made: list[Any] = []

    def add(*_: object, **__: object) -> Any:
        made.append(SimpleNamespace(data=()))
        return made[-1]

    monkeypatch.setattr(server.gui, "add_uplot", add)
    plots, state = LivePlots(server.gui, g1, default_config(ViewConfig, "bridge", "view")), standing(g1)
    for t in (1.0, 1.1, 1.1, 1.2, 0.1, 0.2, 0.2):  # a slow robot repeats a sample; a reset starts again
        plots.add(Snapshot(t, state.q, state.v, np.zeros(g1.nj), np.zeros((2, 6)), np.zeros(6), (), 0.0), Words())
    assert len(made) == 3
    for plot in made:
        np.testing.assert_array_equal(plot.data[0], [0.1, 0.2])
