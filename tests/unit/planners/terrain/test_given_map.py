"""Maps of the ground that are given: their files, those of terrains, and heights that count from the stance sole."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image

from models.errors import ConfigError
from models.range_sensor import DEPTH_FRAME, PointCloud
from models.robot_model import RobotModel
from models.terrain import Box, Ground, Terrain, terrain_named
from planners.terrain.elevation_map import Heights
from planners.terrain.given_map import load_given_map, save_given_map, terrain_heights
from planners.terrain.mapper import Posture, TerrainMapper

NAN = np.nan


def test_a_map_survives_its_file(tmp_path: Path) -> None:
    values = np.array([[0.0, 0.15, NAN], [-0.4, 0.3, 1.2]])  # two along x, three along y
    file = tmp_path / "hall.yaml"
    image = save_given_map(file, Heights(values, (-1.0, 2.5), 0.05))
    found = load_given_map(file)
    np.testing.assert_allclose(found.values, values, atol=2e-5)
    assert (found.corner, found.cell) == ((-1.0, 2.5), 0.05)
    with Image.open(image) as opened:  # as a person looks at it: x to the right, y up
        pixels = np.asarray(opened)
    assert pixels.shape == (3, 2) and pixels[0, 0] == 0 and pixels[2, 1] == 1 and pixels[0, 1] == 65535


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ("image: none.png", "none.png: No such file"),
        ("image: grey.png", "pixels of mode 'L'; save it as a 16-bit grey PNG"),
        ("image: text.png", "text.png: not an image"),
        ("image: grey.png\nheight: 1", "height"),
        ("image: grey.png\nheights: [1.0, 1.0]", "the first is not lower"),
        ("image: grey.png\norigin: [0.0, 0.0, 0.5]", "yaw, must be 0"),
    ],
)
def test_a_malformed_map_is_refused_by_name(tmp_path: Path, lines: str, reason: str) -> None:
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "grey.png")
    (tmp_path / "text.png").write_text("no picture")
    usual = {"resolution": "0.02", "origin": "[0.0, 0.0, 0.0]", "heights": "[0.0, 1.0]"}
    given = [f"{key}: {value}" for key, value in usual.items() if f"{key}:" not in lines]
    file = tmp_path / "map.yaml"
    file.write_text("\n".join([lines, *given]))
    with pytest.raises(ConfigError, match=reason) as caught:
        load_given_map(file)
    assert "map.yaml" in str(caught.value)


def test_a_damaged_image_is_refused_by_name(tmp_path: Path) -> None:
    image = save_given_map(tmp_path / "map.yaml", Heights(np.zeros((4, 3)), (0.0, 0.0), 0.1))
    data = image.read_bytes()
    begin = data.index(b"IDAT")
    image.write_bytes(data[: begin - 1] + b"\x05" + data[begin : begin + 9] + bytes(48))  # the first part is too short
    with pytest.raises(ConfigError, match=r"map\.yaml: image: broken PNG file"):
        load_given_map(tmp_path / "map.yaml")


@pytest.mark.parametrize("name", ["map.png", "nowhere/map.yaml", f"{300 * 'm'}.yaml"])
def test_a_file_that_cannot_be_written_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(name)):
        save_given_map(tmp_path / name, Heights(np.zeros((2, 2)), (0.0, 0.0), 0.1))


@pytest.mark.parametrize("name", ["map.yaml", "map.png"])
def test_an_existing_map_is_kept(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("of a hall")
    ground = Heights(np.zeros((2, 2)), (0.0, 0.0), 0.1)
    with pytest.raises(ConfigError, match=f"{name}: exists already"):
        save_given_map(tmp_path / "map.yaml", ground)
    assert [each.name for each in tmp_path.iterdir()] == [name]
    save_given_map(tmp_path / "map.yaml", ground, overwrite=True)
    assert load_given_map(tmp_path / "map.yaml").values.shape == (2, 2)


@pytest.mark.parametrize("name", ["tiles", "slope_up", "slope_across", "flight", "stones"])
def test_the_map_of_a_terrain_has_its_heights(name: str) -> None:
    terrain = replace(terrain_named(name), length=5.0, width=1.2)
    found, truth = terrain_heights(terrain), Ground(terrain)
    places = np.random.default_rng(3).uniform((-0.5, -1.1), (4.5, 1.1), size=(300, 2))
    middles = (np.floor((places - found.corner) / found.cell) + 0.5) * found.cell + found.corner
    np.testing.assert_allclose(found.at(middles), [truth.height(x, y) for x, y in middles], atol=1e-6)
    assert np.isnan(found.at(np.array([[1.0, 1.3], [6.0, 0.0]]))).all()


def test_a_box_is_on_the_map_of_flat_ground() -> None:
    found = terrain_heights(Terrain("flat", obstacle=Box((0.4, 0.6, 0.2), (1.5, 0.0))))
    np.testing.assert_allclose(found.at(np.array([[1.45, 0.25], [1.0, 0.0], [-0.9, 2.0]])), [0.2, 0.0, 0.0])


def stairs(x: float) -> float:
    return 0.15 * np.floor((x + 0.5) / 0.3 - 1e-9)


def test_given_heights_count_from_the_stance_sole(g1: RobotModel) -> None:
    middles = 0.02 * np.arange(-50, 150) + 0.01
    given = Heights(np.repeat([[stairs(x)] for x in middles], 60, axis=1), (-1.0, -0.6), 0.02)
    mapper, q = TerrainMapper(g1, given=given), g1.standing_configuration()
    q[2] += 0.3  # drift of the odometry
    mapper.follow(0.0, Posture(q, (True, True)))
    ahead = np.array([[0.31, 0.0], [0.65, 0.2], [1.15, -0.2]])
    expected = [stairs(x) - stairs(0.0) for x in ahead[:, 0]]
    np.testing.assert_allclose(mapper.map.at(ahead), expected, atol=1e-9)
    np.testing.assert_allclose(mapper.ground().at(ahead), np.array(expected) + mapper.reference, atol=1e-9)
    assert np.isnan(mapper.map.at(np.array([[0.5, 0.7]]))).all()  # beside what is given
    mapper.follow(3600.0, Posture(q, (True, True)))
    np.testing.assert_allclose(mapper.map.at(ahead), expected, atol=1e-9)  # however long it stands
    mapper.map.height[:] += 0.04  # what is known, for instance seen, is kept
    mapper.follow(3600.1, Posture(q, (True, True)))
    np.testing.assert_allclose(mapper.map.at(ahead), np.array(expected) + 0.04, atol=1e-9)


def seen_from(robot: RobotModel, q: np.ndarray, height: float) -> PointCloud:
    """Level ground ahead of the robot as its depth camera measures it."""
    data = robot.data()
    pin.framesForwardKinematics(robot.pin, data, q)
    places = [(x, y, height) for x in np.arange(0.5, 1.0, 0.005) for y in np.arange(-0.3, 0.3, 0.01)]
    place = data.oMf[robot.frame_id(DEPTH_FRAME)]
    return PointCloud(0.0, DEPTH_FRAME, (np.array(places) - place.translation) @ place.rotation)


@pytest.mark.parametrize(("given", "real"), [(0.0, 0.3), (0.2, 0.0), (0.0, 0.15)])
def test_what_is_seen_replaces_what_is_given(g1: RobotModel, given: float, real: float) -> None:
    middles = 0.02 * np.arange(-50, 100) + 0.01
    heights = Heights(np.repeat(given * (middles > 0.4)[:, None], 60, axis=1), (-1.0, -0.6), 0.02)
    mapper, q = TerrainMapper(g1, given=heights), g1.standing_configuration()
    places, cloud = np.array([[x, y] for x in (0.6, 0.7, 0.8) for y in (-0.1, 0.0, 0.1)]), seen_from(g1, q, real)
    for k in range(30):
        mapper.update(PointCloud(k / 30.0, cloud.frame, cloud.points), Posture(q, (True, True)))
    np.testing.assert_allclose(mapper.map.at(places), real, atol=0.01)
    assert mapper.map.at(np.array([[1.5, 0.0]])) == pytest.approx(given)


def test_nothing_is_taken_from_a_map_that_does_not_know_the_ground_below(g1: RobotModel) -> None:
    given = Heights(np.zeros((20, 20)), (1.0, -0.2), 0.02)
    mapper = TerrainMapper(g1, given=given)
    mapper.follow(0.0, Posture(g1.standing_configuration(), (True, True)))
    assert not mapper.map.known.any() and not mapper.covered


def test_a_robot_without_range_sensors_can_have_a_given_map(g1: RobotModel) -> None:
    blind = RobotModel(replace(g1.profile, sensors=replace(g1.profile.sensors, depth=None, lidar=None)))
    with pytest.raises(ConfigError, match=re.escape("sensors.depth, sensors.lidar")):
        TerrainMapper(blind)
    mapper = TerrainMapper(blind, given=Heights(np.zeros((100, 100)), (-1.0, -1.0), 0.02))
    mapper.follow(0.0, Posture(blind.standing_configuration(), (True, True)))
    assert mapper.map.known.any()
