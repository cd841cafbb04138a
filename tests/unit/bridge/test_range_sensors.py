"""The simulated depth camera and lidar: places of what they see, their errors, and the robot in their way."""

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import yaml

from bridge.plants.range_sensors import RayWorld, SimulatedDepthCamera, SimulatedLidar
from models.errors import ConfigError
from models.mujoco_model import build_mujoco, pin_to_mujoco
from models.profile import load_profile
from models.range_sensor import DEPTH_FRAME, PointCloud
from models.robot_model import RobotModel
from models.terrain import Ground, terrain_named
from planners.terrain.mapper import Posture, TerrainMapper


def in_world(robot: RobotModel, q: np.ndarray, cloud: PointCloud) -> np.ndarray:
    data = robot.data()
    pin.framesForwardKinematics(robot.pin, data, q)
    place = data.oMf[robot.frame_id(cloud.frame)]
    return cloud.points @ place.rotation.T + place.translation


@pytest.fixture(scope="module")
def world(g1: RobotModel) -> RayWorld:
    world = RayWorld(g1, "box")
    world.set(g1.standing_configuration())
    return world


@pytest.mark.parametrize("terrain", ["tiles", "slope_up", "slope_across"])
def test_points_without_errors_lie_on_the_ground(g1: RobotModel, terrain: str) -> None:
    """Of the depth camera all, of the lidar those near the ground: it sees the robot and what is beside, too."""
    q, ground = g1.standing_configuration(), Ground(terrain_named(terrain))
    q[0] += 0.8
    world = RayWorld(g1, terrain)
    world.set(q)
    points = in_world(g1, q, SimulatedDepthCamera(world, noise=0.0).cloud(0.0))
    heights = np.array([ground.height(x, y) for x, y in points[::7, :2]])
    assert len(points) > 6000  # the rest is out of range, beside the slope
    assert np.median(np.abs(points[::7, 2] - heights)) < 1e-6  # beside the faces between two tiles
    middle = np.abs(points[::7, 1]) < 1.0
    assert (np.abs(points[::7, 2] - heights)[middle] < 0.031).all()
    points = in_world(g1, q, SimulatedLidar(world, noise=0.0).cloud(0.0))
    near = points[np.hypot(points[:, 0] - q[0], points[:, 1]) < 2.0]
    below = near[near[:, 2] < 0.4][::7]
    heights = np.array([ground.height(x, y) for x, y in below[:, :2]])
    assert len(below) > 500 and np.median(np.abs(below[:, 2] - heights)) < 1e-6


def test_rays_meet_what_mujoco_meets_one_by_one(g1: RobotModel) -> None:
    """No geom is left out that a ray would have met, and the robot's links are in the way but for the sensor's."""
    q = g1.standing_configuration()
    q[7 + g1.joint_index("left_hip_pitch_joint")] -= 0.8
    world = RayWorld(g1, "tiles")
    world.set(q)
    mj = build_mujoco(g1, visuals=True, terrain="tiles")
    model, data = mj.model, mujoco.MjData(mj.model)
    data.qpos[:], _ = pin_to_mujoco(g1, mj, q, np.zeros(g1.nv))
    mujoco.mj_kinematics(model, data)
    site = model.site(DEPTH_FRAME)
    own = model.body_weldid[model.site_bodyid[site.id]]
    model.geom_group[model.body_weldid[model.geom_bodyid] == own] = 5
    groups = np.array([1, 1, 1, 0, 0, 0], dtype=np.uint8)
    rays = np.random.default_rng(2).normal(size=(400, 3)) * (0.7, 0.5, 0.1) + (0.0, 0.0, 1.0)
    geom = np.zeros(1, dtype=np.int32)
    axes = data.site_xmat[site.id].reshape(3, 3)
    expected, hit = [], set()
    for ray in rays:
        distance = mujoco.mj_ray(model, data, data.site_xpos[site.id], axes @ ray, groups, True, -1, geom)
        expected.append(distance if distance >= 0.0 else np.inf)
        hit.add(int(model.body_rootid[model.geom_bodyid[geom[0]]]))
    found = world.cast(DEPTH_FRAME, rays, 30.0)
    near = np.array(expected) * np.linalg.norm(rays, axis=1) < 30.0
    np.testing.assert_allclose(found[near], np.array(expected)[near], rtol=1e-9)
    assert hit == {0, mj.base_body}  # ground and robot


def test_a_raised_leg_hides_the_ground(g1: RobotModel) -> None:
    q = g1.standing_configuration()
    q[7 + g1.joint_index("left_hip_pitch_joint")] -= 1.2
    world = RayWorld(g1)
    world.set(q)
    camera = SimulatedDepthCamera(world, noise=0.0)
    points = in_world(g1, q, camera.cloud(0.0))
    raised = points[points[:, 2] > 0.05]
    assert 50 < len(raised) < 3000 and (raised[:, 1] > -0.05).all()  # it is the left one
    assert (np.hypot(*raised[:, :2].T) < 0.8).all()


def test_the_errors_are_those_of_the_profile(world: RayWorld) -> None:
    exact = SimulatedDepthCamera(world, noise=0.0).picture()
    camera = SimulatedDepthCamera(world, seed=5)
    pictures = np.array([camera.picture() for _ in range(40)])
    np.testing.assert_allclose(pictures.std(axis=0).mean(), camera.config.deviation(exact).mean(), rtol=0.05)
    camera.reset(5)
    np.testing.assert_array_equal(camera.picture(), pictures[0])


def test_mounting_and_scale_are_wrong_by_what_the_profile_says(g1: RobotModel, world: RayWorld) -> None:
    """Of one sensor they stay: the floor is tilted by the first and, under the camera, too deep by the second."""
    q, camera, data = g1.standing_configuration(), SimulatedDepthCamera(world), g1.data()
    pin.framesForwardKinematics(g1.pin, data, q)
    place, planes = data.oMf[g1.frame_id(DEPTH_FRAME)].translation, []
    for seed in range(60):
        camera.reset(seed)
        points = in_world(g1, q, camera.cloud(0.0)) - place
        columns = np.column_stack([points[:, :2], np.ones(len(points))])
        planes.append(np.linalg.lstsq(columns, points[:, 2], rcond=None)[0])
    slope_x, slope_y, depth = np.std(planes, axis=0)
    assert slope_x == pytest.approx(camera.config.misalignment, rel=0.3)
    assert slope_y == pytest.approx(camera.config.misalignment, rel=0.3)
    assert depth / place[2] == pytest.approx(camera.config.scale, rel=0.3)


def test_the_lidar_looks_down_all_around_with_another_pattern_in_every_turn(g1: RobotModel, world: RayWorld) -> None:
    lidar = SimulatedLidar(world, noise=0.0)
    first, second = lidar.cloud(0.0), lidar.cloud(0.1)
    elevation = np.arcsin(first.points[:, 2] / np.linalg.norm(first.points, axis=1))
    assert elevation.min() >= lidar.config.elevation_min - 1e-9 and elevation.max() <= lidar.config.elevation_max + 1e-9
    azimuth = np.arctan2(first.points[:, 1], first.points[:, 0])
    assert np.histogram(azimuth, 12, (-np.pi, np.pi))[0].min() > 500
    points = in_world(g1, g1.standing_configuration(), first)
    assert np.percentile(points[:, 2], 90) < 1e-6  # it hangs upside down
    shared = {tuple(row) for row in np.round(first.points, 6)} & {tuple(row) for row in np.round(second.points, 6)}
    assert len(shared) < 10
    lidar.reset()
    np.testing.assert_array_equal(lidar.cloud(0.0).points, first.points)


def test_a_box_is_seen_where_it_is_put(g1: RobotModel, world: RayWorld) -> None:
    camera, q = SimulatedDepthCamera(world, noise=0.0), g1.standing_configuration()
    assert np.abs(in_world(g1, q, camera.cloud(0.0))[:, 2]).max() < 1e-6
    world.obstacle = np.array([1.5, 0.0, 0.75])
    world.set(q)
    points = in_world(g1, q, camera.cloud(0.0))
    box = points[points[:, 2] > 1e-6]
    assert len(box) > 200 and box[:, 0] == pytest.approx(1.3, abs=1e-6)  # its near face
    world.obstacle = np.array([0.0, 0.0, -100.0])
    world.set(q)


def test_nothing_is_measured_out_of_range(world: RayWorld) -> None:
    camera = SimulatedDepthCamera(world, noise=0.0)
    picture = camera.picture()
    object.__setattr__(camera, "_limits", camera.config.__class__(**{**vars_of(camera.config), "range_max": 1.5}))
    np.testing.assert_array_equal(np.isnan(camera.picture()), picture > 1.5)
    assert np.isnan(camera.picture()).any()


def vars_of(config: object) -> dict[str, float]:
    return {name: getattr(config, name) for name in config.__dataclass_fields__}  # type: ignore[attr-defined]


def test_robots_without_them_and_senseless_values_are_refused(g1: RobotModel, tmp_path: Path) -> None:
    world = RayWorld(RobotModel.load("talos_hardware"))
    with pytest.raises(ConfigError, match=r"talos_hardware: sensors\.depth"):
        SimulatedDepthCamera(world)
    with pytest.raises(ConfigError, match=r"talos_hardware: sensors\.lidar"):
        SimulatedLidar(world)
    file = tmp_path / "robot.yaml"
    for change, culprit in (
        ({"sensors": {"depth": {"range_min": 9.0}}}, "range_min 9.0 m is not below range_max 6.0 m"),
        ({"sensors": {"lidar": {"rays": 1}}}, "sensors.lidar.rays"),
        ({"frames": {"lidar": None}}, "frames.lidar"),
    ):
        file.write_text(yaml.safe_dump({"extends": "g1", "name": "other", **change}))
        with pytest.raises(ConfigError, match=culprit):
            load_profile(file)


def test_the_body_hides_no_floor_ahead_of_the_feet_and_none_of_it_is_mapped(robot: RobotModel) -> None:
    """While it stands, without errors: two pictures show nearly all of where the feet go next, from 0.4 m ahead on."""
    q, world = robot.standing_configuration(), RayWorld(robot)
    world.set(q)
    mapper = TerrainMapper(robot)
    for sensor in (SimulatedDepthCamera(world, noise=0.0), SimulatedLidar(world, noise=0.0)):
        for t in (0.0, 0.1):
            mapper.update(sensor.cloud(t), Posture(q, (True, True)))
    heights = mapper.map.height[mapper.map.known]
    assert np.abs(heights).max() < 0.01
    floor = np.array([[x, y] for x in np.arange(0.4, 1.3, 0.02) for y in np.arange(-0.2, 0.2, 0.02)])
    assert np.isfinite(mapper.ground().at(floor)).mean() > 0.9
