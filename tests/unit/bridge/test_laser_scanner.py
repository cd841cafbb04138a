"""The simulated scanner: known distances, its noise, what it does not see, and the box that it is to see."""

import math
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml

from bridge.plants.mujoco import MujocoPlant
from bridge.plants.scanner import LaserScanner
from models.errors import CommandError, ConfigError
from models.mujoco_model import build_mujoco
from models.mujoco_spec import WORLD_GROUP
from models.robot_model import RobotModel
from planners.motion import MotionPlanner

WALL = 2.5
"""Distance of the terrain 'wall' from where the robot starts [m]."""


@pytest.fixture(scope="module")
def plant(g1: RobotModel) -> MujocoPlant:
    return MujocoPlant(g1, terrain="wall")


def test_a_wall_is_where_it_stands(robot: RobotModel) -> None:
    """Rays that meet it have its distance over the cosine of their direction, the others nothing."""
    plant = MujocoPlant(robot, terrain="wall")
    scanner = LaserScanner(plant, noise=0.0)
    scan = scanner.scan(3.0)
    assert (scan.t, scan.range_max, len(scan.ranges)) == (3.0, scanner.config.range_max, scanner.config.rays)
    assert scan.angle_max == pytest.approx(scanner.config.angle_max)
    origin = plant.data.site("scan").xpos
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    meets = (np.cos(angles) > 0.0) & (np.abs(np.tan(angles) * (WALL - origin[0]) + origin[1]) < 1.999)
    misses = (np.cos(angles) <= 0.0) | (np.abs(np.tan(angles) * (WALL - origin[0]) + origin[1]) > 2.101)
    np.testing.assert_allclose(scan.ranges[meets], (WALL - origin[0]) / np.cos(angles[meets]), rtol=1e-6)
    assert meets.sum() > 80 and np.isposinf(scan.ranges[misses]).all()
    assert scan.points[:, 0].max() < WALL + 0.11  # within the wall's thickness


def test_the_noise_is_that_of_the_profile(plant: MujocoPlant) -> None:
    exact = LaserScanner(plant, noise=0.0).scan(0.0).ranges
    scanner = LaserScanner(plant, seed=5)
    errors = np.array([scanner.scan(0.0).ranges for _ in range(30)])[:, np.isfinite(exact)] - exact[np.isfinite(exact)]
    assert errors.std() == pytest.approx(scanner.config.noise, rel=0.1)
    assert abs(errors.mean()) < 0.1 * scanner.config.noise
    scanner.reset()
    np.testing.assert_array_equal(scanner.scan(0.0).ranges, LaserScanner(plant, seed=5).scan(0.0).ranges)
    scanner.reset(6)
    assert (scanner.scan(0.0).ranges != LaserScanner(plant, seed=5).scan(0.0).ranges).any()


def test_scanning_leaves_the_other_sensors_alone(g1: RobotModel) -> None:
    def samples(*, scans: bool) -> list[np.ndarray]:
        plant = MujocoPlant(g1, terrain="box", seed=3)
        scanner, seen = LaserScanner(plant, seed=3), []
        for _ in range(5):
            if scans:
                scanner.scan(plant.t)
            seen.append(np.concatenate([plant.read().gyro, plant.read().q]))
            plant.step()
        return seen

    np.testing.assert_array_equal(samples(scans=True), samples(scans=False))


@pytest.mark.parametrize("visuals", [False, True])
def test_the_robot_is_in_other_groups_than_the_world(g1: RobotModel, visuals: bool) -> None:
    mj = build_mujoco(g1, terrain="wall", visuals=visuals).model
    own = np.isin(mj.body_rootid[mj.geom_bodyid], [mj.body(g1.profile.base_link).id])
    assert own.sum() > 10 and (mj.geom_group[own] != WORLD_GROUP).all()
    assert (mj.geom_group[~own] == WORLD_GROUP).all()


def test_the_robot_does_not_see_itself(robot: RobotModel) -> None:
    """Standing and all along a wave, with every shape that may be drawn."""
    plant = MujocoPlant(robot, terrain="box", visuals=True)
    scanner = LaserScanner(plant)
    wave = MotionPlanner(robot).plan("wave", start_q=robot.posture("stand"))
    postures = [
        robot.posture("stand"),
        *(wave.positions[i] for i in np.linspace(0, len(wave.positions) - 1, 12, dtype=int)),
    ]
    for joints in postures:
        plant.clamp(joints)
        assert np.isposinf(scanner.scan(0.0).ranges).all()


def test_a_robot_that_leans_sees_the_floor_far_away(plant: MujocoPlant) -> None:
    """The plane of the rays leans with the robot: ahead it meets the floor at height / tan(lean)."""
    plant.reset()
    plant.obstacle.remove()
    lean = 0.3
    plant.data.qpos[3:7] = np.roll(pin.Quaternion(pin.rpy.rpyToMatrix(0.0, lean, 0.0)).coeffs(), 1)
    mujoco.mj_forward(plant.model, plant.data)
    scan = LaserScanner(plant, noise=0.0).scan(0.0)
    ahead = round(-scan.angle_min / scan.angle_increment)
    height = plant.data.site("scan").xpos[2]
    assert scan.ranges[ahead] == pytest.approx(height / math.sin(lean), rel=1e-3)
    assert np.nanmin(scan.ranges) > 2.0
    plant.reset()


def test_the_box_goes_where_it_is_put(g1: RobotModel) -> None:
    plant = MujocoPlant(g1, terrain="box")
    scanner = LaserScanner(plant, noise=0.0)
    origin = plant.data.site("scan").xpos[:2].copy()

    def nearest() -> tuple[float, float]:
        plant.step()
        points = scanner.scan(plant.t).points
        if not len(points):
            return math.inf, math.inf
        x, y = points[np.linalg.norm(points, axis=1).argmin()]
        return float(x + origin[0]), float(y + origin[1])

    assert nearest() == (math.inf, math.inf)
    plant.obstacle.place(1.5, 0.0)
    assert nearest()[0] == pytest.approx(1.3, abs=0.01)  # its near face
    plant.obstacle.place(0.0, -2.0)
    assert nearest()[1] == pytest.approx(-1.8, abs=0.01)
    plant.obstacle.remove()
    assert nearest() == (math.inf, math.inf)
    plant.obstacle.place(1.5, 0.0)
    plant.reset()
    assert nearest() == (math.inf, math.inf)
    with pytest.raises(CommandError, match="not finite"):
        plant.obstacle.place(math.nan, 0.0)


def test_readings_outside_the_range_follow_the_convention(g1: RobotModel) -> None:
    plant = MujocoPlant(g1, terrain="box")
    scanner = LaserScanner(plant, noise=0.0)
    ahead = scanner.config.rays // 2
    x = float(plant.data.site("scan").xpos[0])
    for face, expected in ((0.01, -math.inf), (11.9, 11.9), (12.1, math.inf)):
        plant.obstacle.place(x + face + 0.2, 0.0)
        mujoco.mj_kinematics(plant.model, plant.data)
        assert scanner.scan(0.0).ranges[ahead] == pytest.approx(expected, rel=1e-3)


def test_a_terrain_without_obstacle_has_none(g1: RobotModel) -> None:
    plant = MujocoPlant(g1)
    assert "obstacle" not in plant.mujoco.bodies and plant.model.nmocap == 1
    plant.obstacle.remove()
    with pytest.raises(CommandError, match="start with the terrain 'box' or 'wall'"):
        plant.obstacle.place(1.0, 0.0)


def test_the_weld_holds_the_robot_beside_an_obstacle(plant: MujocoPlant) -> None:
    """Both are mocap bodies; the weld's is the first."""
    plant.reset()
    for _ in range(50):
        plant.step()
    assert plant.truth.q[:3] == pytest.approx(plant.robot.standing_configuration()[:3], abs=0.002)


def test_a_robot_without_scanner_is_refused(root: Path, tmp_path: Path) -> None:
    data = yaml.safe_load((root / "models" / "robots" / "g1.yaml").read_text())
    del data["sensors"]["scan"]
    (tmp_path / "blind.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(ConfigError, match=r"sensors\.scan: the profile has no scanner"):
        LaserScanner(MujocoPlant(RobotModel.load(tmp_path / "blind.yaml")))
