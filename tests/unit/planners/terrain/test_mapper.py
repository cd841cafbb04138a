"""The mapper: heights above the stance sole whatever the odometry drifts, soles that correct it, the robot left out."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from matplotlib.path import Path

from models.config import default_config
from models.errors import ConfigError, MessageError
from models.range_sensor import DEPTH_FRAME, LIDAR_FRAME, PointCloud
from models.robot_model import RobotModel
from planners.terrain.config import TerrainMapConfig
from planners.terrain.mapper import Posture, TerrainMapper

AHEAD = np.array([[x, y] for x in np.arange(0.3, 1.2, 0.01) for y in np.arange(-0.5, 0.5, 0.01)])
BELOW = np.array([[x, y] for x in np.arange(-0.2, 0.3, 0.01) for y in np.arange(-0.3, 0.3, 0.01)])
BOTH, LEFT, RIGHT = (True, True), (True, False), (False, True)


@pytest.fixture
def mapper(g1: RobotModel) -> TerrainMapper:
    return TerrainMapper(g1)


def placed(robot: RobotModel, q: np.ndarray) -> pin.Data:
    data = robot.data()
    pin.framesForwardKinematics(robot.pin, data, q)
    return data


def cloud_of(
    robot: RobotModel, q: np.ndarray, points: np.ndarray, t: float = 0.0, frame: str = DEPTH_FRAME
) -> PointCloud:
    """Points of W (n, 3) as a sensor of a robot in a configuration measures them."""
    place = placed(robot, q).oMf[robot.frame_id(frame)]
    return PointCloud(t, frame, (points - place.translation) @ place.rotation)


def ground(height: float, places: np.ndarray = AHEAD) -> np.ndarray:
    return np.column_stack([places, np.full(len(places), height)])


def lifted(robot: RobotModel, q: np.ndarray, side: str, knee: float) -> tuple[np.ndarray, float]:
    """A configuration with a foot raised, sole level, and how far it is raised [m]."""
    q = q.copy()
    for joint, angle in (("hip_pitch", -0.5 * knee), ("knee", knee), ("ankle_pitch", -0.5 * knee)):
        q[7 + robot.joint_index(f"{side}_{joint}_joint")] += angle
    data = placed(robot, q)
    heights = [float(data.oMf[foot.frame_id].translation[2]) for foot in robot.feet]
    return q, abs(heights[0] - heights[1])


def test_heights_are_above_the_stance_sole_whatever_the_odometry_drifts(g1: RobotModel, mapper: TerrainMapper) -> None:
    for k, drift in enumerate((0.0, 0.05, 0.2, -0.3)):
        q = g1.standing_configuration()
        q[2] += drift  # the estimate of the whole robot, its feet included
        assert mapper.update(cloud_of(g1, q, ground(drift + 0.1), 0.1 * k), Posture(q, LEFT)) > 2000
        np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), 0.1, atol=1e-6)
        assert mapper.reference == pytest.approx(drift, abs=1e-6)


def test_a_foot_that_lands_higher_becomes_the_reference(g1: RobotModel, mapper: TerrainMapper) -> None:
    q = g1.standing_configuration()
    raised, rise = lifted(g1, q, "right", 0.6)
    assert rise > 0.05
    mapper.update(cloud_of(g1, q, ground(0.0)), Posture(q, BOTH))
    mapper.update(cloud_of(g1, q, ground(0.0), 0.1), Posture(raised, LEFT))
    np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), 0.0, atol=1e-6)
    mapper.update(PointCloud(0.2, DEPTH_FRAME, np.zeros((0, 3))), Posture(raised, BOTH))  # it stands on a step
    np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), -rise, atol=1e-6)
    assert mapper.reference == pytest.approx(rise, abs=1e-6)


def test_a_reference_lost_without_double_support_is_bridged_by_the_odometry(
    g1: RobotModel, mapper: TerrainMapper
) -> None:
    q = g1.standing_configuration()
    raised, rise = lifted(g1, q, "right", 0.6)
    mapper.update(cloud_of(g1, q, ground(0.0)), Posture(q, LEFT))
    mapper.update(PointCloud(0.1, DEPTH_FRAME, np.zeros((0, 3))), Posture(raised, RIGHT))
    np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), -rise, atol=1e-6)


def test_feet_are_followed_where_no_cloud_comes(g1: RobotModel, mapper: TerrainMapper) -> None:
    """A stair climbed without a cloud: in the end the foot that stood before stands again, one rise higher."""
    q = g1.standing_configuration()
    raised, rise = lifted(g1, q, "right", 0.6)
    mapper.update(cloud_of(g1, q, ground(0.0)), Posture(q, LEFT))
    i, j = mapper.map.index(AHEAD[:1])[0][0]
    variance = mapper.map.variance[i, j]
    above = q.copy()
    above[2] += rise
    for k, (state, contacts) in enumerate(
        ((raised, LEFT), (raised, BOTH), (raised, RIGHT), (above, BOTH), (above, LEFT))
    ):
        mapper.follow(0.1 + 0.1 * k, Posture(state, contacts))
    np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), -rise, atol=1e-6)
    assert (mapper.t, mapper.reference) == (pytest.approx(0.5), pytest.approx(rise, abs=1e-6))
    fusion = mapper.config.fusion
    assert mapper.map.variance[i, j] - variance == pytest.approx(0.5 * fusion.drift + 2.0 * fusion.step)


def test_a_late_cloud_moves_no_reference(g1: RobotModel, mapper: TerrainMapper) -> None:
    """The lidar's cloud from before the touchdown that the camera's cloud has followed."""
    q = g1.standing_configuration()
    raised, rise = lifted(g1, q, "right", 0.6)
    mapper.update(cloud_of(g1, q, ground(0.0)), Posture(raised, LEFT))
    empty = PointCloud(0.2, DEPTH_FRAME, np.zeros((0, 3)))
    mapper.update(empty, Posture(raised, BOTH))
    late = cloud_of(g1, raised, ground(0.0), 0.1, LIDAR_FRAME)
    assert mapper.update(late, Posture(raised, LEFT)) > 2000
    np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), -rise, atol=1e-3)
    assert (mapper.reference, mapper.t) == (pytest.approx(rise, abs=1e-6), 0.2)
    mapper.update(PointCloud(0.3, DEPTH_FRAME, empty.points), Posture(raised, BOTH))
    np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), -rise, atol=1e-3)
    assert mapper.reference == pytest.approx(rise, abs=1e-6) and mapper.t == 0.3


@pytest.mark.parametrize("frame", [DEPTH_FRAME, LIDAR_FRAME])
def test_points_out_of_the_sensors_range_are_left_out(g1: RobotModel, frame: str) -> None:
    """As of drivers that send zeros for pixels without a measurement; heights and robot hide none of them here."""
    config = default_config(TerrainMapConfig, "planners", "terrain_map")
    mapper = TerrainMapper(g1, replace(config, length=10.0, height_max=50.0, depth_max=50.0))
    mapper._body.outside = lambda points, data: np.ones(len(points), dtype=bool)  # type: ignore[method-assign]
    q, sensor = g1.standing_configuration(), mapper._sensors[frame]
    ray = np.array([0.0, 0.0, 1.0])
    if frame == LIDAR_FRAME:  # its reach is beyond the map: upwards
        ray = placed(g1, q).oMf[g1.frame_id(frame)].rotation.T @ ray
    for distance in (0.0, 0.5 * sensor.range_min, 1.01 * sensor.range_max):
        assert mapper.update(PointCloud(0.0, frame, np.tile(distance * ray, (9, 1))), Posture(q, BOTH)) == 0
    if frame == DEPTH_FRAME:
        assert mapper.update(PointCloud(0.0, frame, np.tile(-ray, (9, 1))), Posture(q, BOTH)) == 0
    assert np.isnan(mapper.map.height).all() and np.isinf(mapper.map.variance).all()
    assert mapper.update(PointCloud(0.0, frame, np.tile(2.0 * sensor.range_min * ray, (9, 1))), Posture(q, BOTH)) == 1


@pytest.mark.parametrize("error", [0.02, -0.03, 0.08])
def test_landed_soles_shift_map_and_coming_clouds_by_a_kalman_filter(
    g1: RobotModel, mapper: TerrainMapper, error: float
) -> None:
    """The first one almost by the whole error; one of 8 cm is an edge."""
    q = g1.standing_configuration()
    wrong = cloud_of(g1, q, ground(error, np.concatenate([AHEAD, BELOW])))
    mapper._body.outside = lambda points, data: np.ones(len(points), dtype=bool)  # type: ignore[method-assign]
    mapper.update(wrong, Posture(q, RIGHT))
    feet, left = mapper.config.feet, error
    variance = feet.bias**2
    for k in range(3):
        for contacts in (BOTH, RIGHT if k % 2 else LEFT):
            mapper.update(PointCloud(0.1 + k, DEPTH_FRAME, np.zeros((0, 3))), Posture(q, contacts))
        assert mapper.residual == pytest.approx(-left, abs=1e-4)
        variance += feet.drift**2
        if abs(error) <= feet.limit:
            left, variance = (
                left * feet.below**2 / (variance + feet.below**2),
                1.0 / (1.0 / variance + 1.0 / feet.below**2),
            )
        np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), left, atol=1e-4)
        mapper.update(PointCloud(0.2 + k, DEPTH_FRAME, wrong.points), Posture(q, contacts))
        np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), left, atol=1e-4)
    assert abs(left) < 0.03 * abs(error) or error == 0.08


@pytest.mark.parametrize(("slope", "shifted"), [(0.0, True), (0.05, False)])
def test_a_standing_robot_learns_from_level_ground_in_front_how_high_its_soles_are(
    g1: RobotModel, mapper: TerrainMapper, slope: float, shifted: bool
) -> None:
    q, feet = g1.standing_configuration(), mapper.config.feet
    points = ground(0.02)
    points[:, 2] += slope * points[:, 0]
    mapper.update(cloud_of(g1, q, points), Posture(q, BOTH))
    assert np.isnan(mapper.residual)  # with what was seen before
    mapper.update(PointCloud(0.1, DEPTH_FRAME, np.zeros((0, 3))), Posture(q, BOTH))
    assert np.isfinite(mapper.residual) == shifted
    left = 0.02 * feet.ahead**2 / (feet.ahead**2 + feet.bias**2) if shifted else points[::50, 2]
    np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), left, atol=2e-3 if slope else 1e-4)
    mapper.update(PointCloud(0.2, DEPTH_FRAME, np.zeros((0, 3))), Posture(q, BOTH))  # once
    np.testing.assert_allclose(mapper.map.at(AHEAD[::50]), left, atol=2e-3 if slope else 1e-4)


def test_the_robot_is_left_out_and_the_ground_beside_it_is_not(g1: RobotModel, mapper: TerrainMapper) -> None:
    q, _ = lifted(g1, g1.standing_configuration(), "left", 0.9)
    data, rng = placed(g1, q), np.random.default_rng(1)
    own = []
    for hull in g1.profile.hulls.values():
        link = data.oMf[g1.pin.getFrameId(hull.link, pin.FrameType.BODY)]
        direction = rng.normal(size=(40, 3))
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        shares = rng.uniform(size=(40, 1))
        middle = np.array(hull.start) + shares * (np.array(hull.end) - np.array(hull.start))
        own.append((middle + hull.radius * direction) @ link.rotation.T + link.translation)
    for foot in g1.feet:
        sole, x = data.oMf[foot.frame_id], rng.uniform(*foot.rectangle[:2], size=40)
        own.append(np.column_stack([x, np.zeros(40), np.full(40, 0.04)]) @ sole.rotation.T + sole.translation)
    for side in ("left", "right"):  # wrists and ankles have no hull
        for name in ("wrist_roll", "wrist_pitch", "wrist_yaw", "ankle_pitch"):
            own.append(
                data.oMi[g1.pin.getJointId(f"{side}_{name}_joint")].translation + rng.uniform(-0.03, 0.03, (40, 3))
            )
    mapper.update(cloud_of(g1, q, np.concatenate(own), frame=LIDAR_FRAME), Posture(q, RIGHT))
    assert not mapper.map.known.any()
    beside = ground(0.0, np.array([[0.0, -0.3], [0.25, 0.1], [0.05, -0.2], [0.4, 0.0]]))
    assert mapper.update(cloud_of(g1, q, beside, 0.1), Posture(q, RIGHT)) == 4


def test_what_hangs_above_or_lies_far_below_is_no_ground(g1: RobotModel, mapper: TerrainMapper) -> None:
    q = g1.standing_configuration()
    for height in (0.9, -1.6):
        assert mapper.update(cloud_of(g1, q, ground(height)), Posture(q, BOTH)) == 0
    assert mapper.update(cloud_of(g1, q, ground(0.7)), Posture(q, BOTH)) > 2000


def test_patches_are_those_of_the_map(g1: RobotModel, mapper: TerrainMapper) -> None:
    q = g1.standing_configuration()
    points = ground(0.0)
    points[:, 2] = 0.15 * (points[:, 0] > 0.7)
    mapper.update(cloud_of(g1, q, points), Posture(q, BOTH))
    low, high = sorted(mapper.patches(), key=lambda patch: patch.vertices[0, 2])
    on_low, on_high = (Path(patch.vertices[:, :2]).contains_point for patch in (low, high))
    assert on_low((0.5, 0.0)) and not on_low((0.69, 0.0))
    assert on_high((0.9, 0.0)) and high.height(0.9, 0.0) == pytest.approx(0.15, abs=1e-3)


def test_clouds_without_a_reference_or_of_a_wrong_form_are_not_mapped(g1: RobotModel, mapper: TerrainMapper) -> None:
    q = g1.standing_configuration()
    assert mapper.update(cloud_of(g1, q, ground(0.0)), Posture(q, (False, False))) == 0
    with pytest.raises(MessageError, match="frame: 'imu', expected one of depth_optical_frame, lidar"):
        mapper.update(PointCloud(0.0, "imu", np.zeros((1, 3))), Posture(q, BOTH))
    with pytest.raises(MessageError, match="points: a coordinate"):
        mapper.update(PointCloud(0.0, DEPTH_FRAME, np.full((1, 3), np.nan)), Posture(q, BOTH))
    with pytest.raises(ConfigError, match=r"talos_hardware: sensors\.depth, sensors\.lidar"):
        TerrainMapper(RobotModel.load("talos_hardware"))
