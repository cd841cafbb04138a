"""From a point in the world to pixels and back to its bearing, on drawn pictures; and where the head has to turn."""

from __future__ import annotations

import ctypes.util
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
import pytest

pytest.importorskip("cv2", reason="the extra 'vision' is not installed")

from controllers.vision.gaze import Gaze
from controllers.vision.target_finder import TargetFinder
from models.camera import Pinhole, azimuth_elevation
from models.errors import ConfigError
from models.profile import CAMERA_FRAME
from models.robot_model import RobotModel

if TYPE_CHECKING:
    from bridge.plants.camera import SimulatedCamera

Colour = tuple[int, int, int]
GREEN, ORANGE, RED = (20, 180, 40), (230, 115, 13), (220, 10, 20)

needs_gl = pytest.mark.skipif(ctypes.util.find_library("EGL") is None, reason="EGL is not installed")


def picture(colour: Colour, u: float, v: float, radius: float) -> np.ndarray:
    """A grey picture with a disc."""
    rows, columns = np.mgrid[0:120, 0:160]
    drawn = np.full((120, 160, 3), 110, dtype=np.uint8)
    drawn[(columns - u) ** 2 + (rows - v) ** 2 <= radius**2] = colour
    return drawn


def test_a_target_is_found_by_its_colour_and_others_are_not() -> None:
    finder = TargetFinder()
    seen = finder.find(picture(GREEN, 50.0, 70.0, 8.0))
    assert seen is not None and seen.whole
    np.testing.assert_allclose(seen.pixel, [50.0, 70.0], atol=0.1)
    assert seen.pixels == pytest.approx(math.pi * 64.0, rel=0.1)
    for colour in (ORANGE, RED, (110, 110, 110), (2, 20, 4), (150, 180, 150)):
        assert finder.find(picture(colour, 50.0, 70.0, 8.0)) is None
    assert finder.find(picture(GREEN, 50.0, 70.0, 1.2)) is None  # too small


def test_the_largest_patch_counts_and_the_edge_is_reported() -> None:
    both = picture(GREEN, 120.0, 30.0, 10.0)
    both[60:64, 20:24] = GREEN
    both[100, 100] = GREEN  # noise
    seen = TargetFinder().find(both)
    assert seen is not None
    np.testing.assert_allclose(seen.pixel, [120.0, 30.0], atol=0.1)
    cut = TargetFinder().find(picture(GREEN, 158.0, 30.0, 10.0))
    assert cut is not None and not cut.whole


@pytest.mark.parametrize(
    ("hue_from", "hue_to", "colours"),
    [(345.0, 15.0, (RED, (220, 20, 10))), (345.0, 360.0, (RED, (220, 20, 20))), (360.0, 15.0, ((220, 20, 10),))],
)
def test_a_range_of_hues_may_go_through_red(hue_from: float, hue_to: float, colours: Sequence[Colour]) -> None:
    red = TargetFinder(replace(TargetFinder().config, hue_from=hue_from, hue_to=hue_to))
    for colour in colours:
        assert red.find(picture(colour, 50.0, 70.0, 8.0)) is not None
    assert red.find(picture(GREEN, 50.0, 70.0, 8.0)) is None


def test_a_pinhole_projects_and_looks_back() -> None:
    camera = Pinhole(320, 240, (277.0, 270.0), (158.0, 121.0))
    for point in ([0.3, -0.2, 2.0], [-1.0, 0.4, 1.5]):
        bearing = camera.bearing(camera.project(np.array(point)))
        np.testing.assert_allclose(bearing, np.array(point) / np.linalg.norm(point), atol=1e-12)
    left_and_up = azimuth_elevation(np.array([-1.0, -1.0, 1.0]))
    assert left_and_up == pytest.approx((math.pi / 4, math.atan(1 / math.sqrt(2))))


@pytest.fixture(scope="module")
def cameras() -> Iterator[dict[str, SimulatedCamera]]:
    """The camera of each robot."""
    from bridge.plants.camera import SimulatedCamera

    made = {name: SimulatedCamera(RobotModel.load(name), terrain="box") for name in ("g1", "talos")}
    yield made
    for camera in made.values():
        camera.close()


@needs_gl
@pytest.mark.parametrize("name", ["g1", "talos"])
def test_a_ball_is_seen_where_it_is(cameras: dict[str, SimulatedCamera], name: str) -> None:
    camera, model = cameras[name], RobotModel.load(name)
    q = model.standing_configuration()
    q[:2] = 0.4, -0.3  # the robot has walked, turned, and leans
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.05, -0.04, 0.7)).coeffs()
    position, axes = camera.place(q)
    frame = pin.Data(model.pin)
    pin.framesForwardKinematics(model.pin, frame, q)
    np.testing.assert_allclose(position, frame.oMf[model.frame_id(CAMERA_FRAME)].translation, atol=1e-9)
    np.testing.assert_allclose(axes, frame.oMf[model.frame_id(CAMERA_FRAME)].rotation, atol=1e-9)
    for point in ([0.0, 0.0, 1.0], [0.25, 0.1, 1.1], [-0.3, -0.15, 1.0]):
        camera.target = position + axes @ np.array(point)
        seen = TargetFinder().find(camera.render(q))
        assert seen is not None and seen.whole
        np.testing.assert_allclose(seen.pixel, camera.intrinsics.project(np.array(point)), atol=1.5)
        direction = camera.intrinsics.bearing(seen.pixel)
        assert math.acos(direction @ point / np.linalg.norm(point)) < math.radians(0.4)
    camera.target = None
    assert TargetFinder().find(camera.render(q)) is None


@needs_gl
def test_the_obstacle_is_seen_where_it_stands(cameras: dict[str, SimulatedCamera]) -> None:
    camera, model = cameras["talos"], RobotModel.load("talos")
    q = model.standing_configuration()
    orange = TargetFinder(replace(TargetFinder().config, hue_from=15.0, hue_to=45.0))
    camera.obstacle = np.array([0.0, 0.0, -100.0])
    assert orange.find(camera.render(q)) is None
    camera.obstacle = np.array([2.0, 0.5, 0.75])
    seen = orange.find(camera.render(q))
    assert seen is not None
    azimuth, elevation = azimuth_elevation(camera.intrinsics.bearing(seen.pixel))
    assert azimuth == pytest.approx(math.atan2(0.5, 1.9), abs=0.05) and elevation < 0.0


def test_the_head_turns_to_what_is_seen_to_the_side(talos: RobotModel) -> None:
    gaze, data = Gaze(talos), talos.data()
    head = talos.profile.head
    assert head is not None
    places = [7 + talos.joint_index(name) for name in (head.pan, head.tilt)]

    def axes(pan: float, tilt: float) -> np.ndarray:
        q = pin.neutral(talos.pin)
        q[places] = pan, tilt
        pin.framesForwardKinematics(talos.pin, data, q)
        return np.array(data.oMf[talos.frame_id(CAMERA_FRAME)].rotation)

    rng = np.random.default_rng(3)
    for _ in range(20):
        now, expected = rng.uniform([-0.5, -0.1], [0.5, 0.5], (2, 2))
        bearing = axes(*now).T @ axes(*expected)[:, 2]
        assert gaze.aim(*now, bearing) == pytest.approx(expected, abs=1e-5)
    assert gaze.aim(0.0, 0.0, np.array([1.0, 0.0, 0.0]))[0] == talos.q_lower[places[0] - 7]  # beyond its reach
    left, _ = gaze.aim(0.0, 0.0, np.array([-0.2, 0.0, 1.0]))
    assert left > 0.0


def test_a_head_that_does_not_carry_the_camera_is_refused_by_name(talos: RobotModel, g1: RobotModel) -> None:
    with pytest.raises(ConfigError, match="g1: head"):
        Gaze(g1)
    frames = talos.profile.frames | {CAMERA_FRAME: replace(talos.profile.frames["gaze"], link="torso_2_link")}
    with pytest.raises(ConfigError, match="not moved by joint 'head_2_joint'"):
        Gaze(RobotModel(replace(talos.profile, frames=frames)))
