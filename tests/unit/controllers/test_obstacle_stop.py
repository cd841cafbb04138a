"""Obstacle stop: who is in the way, how fast one may still go, when a stop is over, and what is no scan."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from controllers.commands.obstacle_stop import BodyOutline, ObstacleStop, ObstacleStopConfig
from models.config import parse_config
from models.errors import ConfigError, MessageError
from models.robot_model import RobotModel
from models.scan import Scan
from tests.scans import empty, posts, wall

AHEAD = np.array([1.0, 0.0])
WAYS = {"ahead": (1.0, 0.0), "behind": (-1.0, 0.0), "on the left": (0.0, 1.0), "on the right": (0.0, -1.0)}


@pytest.fixture
def law(g1: RobotModel) -> ObstacleStop:
    return ObstacleStop(g1)


def _at_gap(model: RobotModel, way: tuple[float, float], gap: float) -> tuple[float, float]:
    """Place in B with so much free way before it [m]."""
    far = BodyOutline(model).reach(np.array(way)) + gap
    return way[0] * far, way[1] * far


@pytest.mark.parametrize("side", WAYS)
def test_only_the_way_to_the_obstacle_is_barred(robot: RobotModel, side: str) -> None:
    law, way = ObstacleStop(robot), WAYS[side]
    law.update(posts(robot, 1.0, _at_gap(robot, way, 0.3)))
    for other in WAYS.values():
        velocity = (0.2 * other[0], 0.2 * other[1], 0.1)
        allowed, reason = law.limit(velocity, 1.0)
        if other == way:
            assert allowed == (0.0, 0.0, 0.1)  # turning stays
            assert reason == f"stopped: obstacle 0.30 m {side}"
        else:
            assert (allowed, reason) == (velocity, "")
    assert law.limit((0.0, 0.0, 0.5), 1.0) == ((0.0, 0.0, 0.5), "")


def test_diagonals_are_ways_of_their_own(law: ObstacleStop, g1: RobotModel) -> None:
    law.update(posts(g1, 1.0, _at_gap(g1, (math.sqrt(0.5), math.sqrt(0.5)), 0.2)))
    assert law.limit((0.1, 0.1, 0.0), 1.0)[0] == (0.0, 0.0, 0.0)
    assert law.limit((0.1, -0.1, 0.0), 1.0)[0] == (0.1, -0.1, 0.0)


def test_the_corridor_is_the_body_and_a_margin(law: ObstacleStop, g1: RobotModel) -> None:
    edge = BodyOutline(g1).reach(np.array([0.0, 1.0])) + law.config.margin
    for y, free in ((edge - 0.02, False), (edge + 0.02, True), (0.02 - edge, False), (-0.02 - edge, True)):
        law.reset()
        law.update(posts(g1, 1.0, (0.5, y)))
        assert math.isinf(law.gap(AHEAD)) is free
        assert (law.limit((0.3, 0.0, 0.0), 1.0)[1] == "") is free


def test_the_outline_covers_the_body(robot: RobotModel) -> None:
    outline = BodyOutline(robot)
    left, right, ahead = (outline.reach(np.array(way)) for way in ((0.0, 1.0), (0.0, -1.0), (1.0, 0.0)))
    assert left == pytest.approx(right, abs=0.01)  # a symmetrical robot
    assert (0.2 if robot.name == "g1" else 0.4) < left < (0.35 if robot.name == "g1" else 0.6)
    assert 0.1 < ahead < 0.3


@pytest.mark.parametrize("gap", [0.45, 0.6, 0.8, 1.2, 2.0])
def test_the_speed_allows_to_halt_in_time(law: ObstacleStop, g1: RobotModel, gap: float) -> None:
    """Reaction and deceleration together take no more than the gap beyond ``stop_distance``."""
    law.update(wall(g1, 1.0, _at_gap(g1, (1.0, 0.0), gap)[0]))
    (forward, left, turn), reason = law.limit((2.0, 0.0, 0.3), 1.0)
    assert reason == "slowed: obstacle ahead"
    assert (left, turn) == (0.0, 0.3)
    c = law.config
    assert c.speed_min <= forward < 2.0
    way = forward * c.reaction_time + forward**2 / (2.0 * c.deceleration)
    assert way == pytest.approx(law.gap(AHEAD) - c.stop_distance, abs=1e-9)
    assert law.gap(AHEAD) == pytest.approx(gap, abs=0.002)


def test_far_obstacles_do_not_slow(law: ObstacleStop, g1: RobotModel) -> None:
    law.update(wall(g1, 1.0, 1.5))
    assert law.limit((0.3, 0.0, 0.2), 1.0) == ((0.3, 0.0, 0.2), "")


def test_a_stop_holds_until_the_way_has_been_free_for_a_while(law: ObstacleStop, g1: RobotModel) -> None:
    c = law.config

    def after(t: float, gap: float) -> tuple[float, str]:
        law.update(posts(g1, t, _at_gap(g1, (1.0, 0.0), gap)))
        allowed, reason = law.limit((0.2, 0.0, 0.0), t)
        return allowed[0], reason

    speed, reason = after(1.0, c.stop_distance)
    assert speed == 0.0
    assert after(1.1, c.release_distance - 0.02) == (0.0, reason)  # not far enough
    assert after(5.0, c.release_distance - 0.02) == (0.0, reason)  # however long
    assert after(5.1, c.release_distance + 0.02) == (0.0, reason)  # far enough, not long enough
    assert after(6.0, c.release_distance - 0.02) == (0.0, reason)  # and back: the time begins anew
    assert after(6.1, c.release_distance + 0.02) == (0.0, reason)
    assert after(6.1 + 0.9 * c.release_time, c.release_distance + 0.02) == (0.0, reason)
    speed, reason = after(6.2 + c.release_time, c.release_distance + 0.02)
    assert speed == pytest.approx(0.2) and not law.stopped
    assert after(7.5 + c.release_time, c.release_distance - 0.1)[0] > 0.0  # between the two, without a stop: it walks


def test_directions_close_to_a_stopped_one_are_stopped(law: ObstacleStop, g1: RobotModel) -> None:
    """Else a little sideways would release the stop."""
    law.update(posts(g1, 1.0, _at_gap(g1, (1.0, 0.0), 0.3)))
    assert law.limit((0.2, 0.0, 0.0), 1.0)[0] == (0.0, 0.0, 0.0)
    law.update(empty(1.1))
    assert law.limit((0.2, 0.1, 0.0), 1.1)[0] == (0.0, 0.0, 0.0)
    assert law.limit((0.1, 0.2, 0.0), 1.1)[0] == (0.1, 0.2, 0.0)
    assert law.limit((-0.2, 0.0, 0.0), 1.1)[0] == (-0.2, 0.0, 0.0)


def test_a_single_reading_is_no_obstacle(law: ObstacleStop) -> None:
    for count in (1, 2):
        law.reset()
        scan = empty(1.0)
        scan.ranges[len(scan.ranges) // 2 : len(scan.ranges) // 2 + count] = 0.4
        law.update(scan)
        assert (law.limit((0.3, 0.0, 0.0), 1.0)[1] == "") is (count == 1)


def test_without_a_fresh_scan_the_robot_does_not_walk(law: ObstacleStop) -> None:
    assert law.limit((0.3, 0.1, 0.4), 1.0) == ((0.0, 0.0, 0.4), "stopped: no scan")
    law.update(empty(1.0))
    assert law.limit((0.3, 0.1, 0.4), 1.0 + law.config.scan_timeout) == ((0.3, 0.1, 0.4), "")
    stale = law.limit((0.3, 0.1, 0.4), 1.01 + law.config.scan_timeout)
    assert stale == ((0.0, 0.0, 0.4), "stopped: no scan within 0.5 s")
    assert law.limit((0.3, 0.1, 0.4), 0.0)[1] == "stopped: no scan within 0.5 s"  # a stamp far ahead is no fresh one
    law.update(empty(2.0))
    assert law.limit((0.3, 0.1, 0.4), 2.0)[1] == ""
    law.reset()
    assert law.limit((0.3, 0.1, 0.4), 2.0)[1] == "stopped: no scan"


def test_a_robot_without_scanner_is_not_limited(root: Path, tmp_path: Path) -> None:
    data = yaml.safe_load((root / "models" / "robots" / "g1.yaml").read_text())
    del data["sensors"]["scan"], data["frames"]["scan"]
    profile = tmp_path / "blind.yaml"
    profile.write_text(yaml.safe_dump(data))
    law = ObstacleStop(RobotModel.load(profile))
    assert not law.expected
    assert law.limit((0.9, 0.1, 0.4), 1.0) == ((0.9, 0.1, 0.4), "")


def test_a_scanner_that_looks_back_is_turned_round(root: Path, tmp_path: Path) -> None:
    data = yaml.safe_load((root / "models" / "robots" / "g1.yaml").read_text())
    data["frames"]["scan"]["rpy"] = [0.0, 0.0, math.pi]
    profile = tmp_path / "back.yaml"
    profile.write_text(yaml.safe_dump(data))
    model = RobotModel.load(profile)
    law = ObstacleStop(model)
    scan = empty(1.0)
    scan.ranges[len(scan.ranges) // 2 + np.arange(-2, 3)] = 0.4  # along its own x
    law.update(scan)
    assert law.limit((0.2, 0.0, 0.0), 1.0)[1] == ""
    assert law.limit((-0.2, 0.0, 0.0), 1.0)[1].endswith("behind")


def test_readings_follow_the_convention(law: ObstacleStop) -> None:
    """Too close to measure is an obstacle; nan, infinity and distances outside the range are none."""
    for value, seen in ((-math.inf, True), (math.inf, False), (math.nan, False), (0.01, False), (12.5, False)):
        law.reset()
        scan = empty(1.0)
        middle = len(scan.ranges) // 2
        scan.ranges[middle - 2 : middle + 3] = value
        law.update(scan)
        assert math.isfinite(law.gap(AHEAD)) is seen, value


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        ({"t": math.nan}, "t is nan"),
        ({"angle_min": math.nan}, "angle_min is nan"),
        ({"angle_increment": 0.0}, "angle_increment is 0"),
        ({"angle_increment": math.inf}, "angle_increment is inf"),
        ({"angle_increment": 0.5}, "angle_increment: 720 readings span 359.500 rad"),  # degrees
        ({"ranges": np.zeros(0)}, "ranges: shape"),
        ({"ranges": np.ones((2, 3))}, "ranges: shape"),
        ({"ranges": np.full(720, math.nan)}, "ranges: every reading is nan"),
        ({"range_min": -0.1}, "range_min -0.1"),
        ({"range_min": math.nan}, "range_min is nan"),
        ({"range_max": 0.01}, "range_max 0.01"),
        ({"t": 1.0}, "t: 1.000000 s is not after"),
        ({"t": 0.5}, "t: 0.500000 s is not after"),
    ],
)
def test_a_malformed_scan_is_refused_and_the_last_one_stays(
    law: ObstacleStop, g1: RobotModel, change: dict[str, Any], culprit: str
) -> None:
    law.update(posts(g1, 1.0, (0.4, 0.0)))
    gap = law.gap(AHEAD)
    with pytest.raises(MessageError, match=culprit):
        law.update(replace(empty(1.1), **change))
    assert law.gap(AHEAD) == gap


def test_a_velocity_that_is_none_stops(law: ObstacleStop) -> None:
    law.update(empty(1.0))
    for bad in ((math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0, math.nan)):
        assert law.limit(bad, 1.0) == ((0.0, 0.0, 0.0), "stopped: the velocity is not finite")


velocities = st.tuples(*[st.floats(-2.0, 2.0)] * 3)
readings = st.lists(
    st.one_of(st.floats(0.0, 13.0), st.sampled_from([math.inf, -math.inf, math.nan])), min_size=2, max_size=60
)


@given(velocities=st.lists(velocities, min_size=1, max_size=4), scans=st.lists(readings, min_size=1, max_size=4))
def test_no_scan_makes_a_walk_faster_or_leads_it_another_way(
    g1: RobotModel, velocities: list[tuple[float, float, float]], scans: list[list[float]]
) -> None:
    law = ObstacleStop(g1)
    for t, ranges in enumerate(scans):
        values = np.array(ranges)
        if not np.isnan(values).all():
            law.update(Scan(float(t), -3.0, 6.0 / len(values), values, 0.02, 12.0))
        for velocity in velocities:
            (forward, left, turn), reason = law.limit(velocity, float(t))
            assert turn == velocity[2]
            assert abs(forward) <= abs(velocity[0]) and abs(left) <= abs(velocity[1])
            assert forward * velocity[0] >= 0.0 and left * velocity[1] >= 0.0
            assert abs(forward * velocity[1] - left * velocity[0]) < 1e-12
            assert bool(reason) is ((forward, left) != velocity[:2])


def test_the_floor_is_not_taken_for_an_obstacle(robot: RobotModel) -> None:
    """A robot that leans by as much as one that stands can (0.3 rad) sees the floor beyond the release distance."""
    law, lean = ObstacleStop(robot), 0.3
    height = robot.standing_configuration()[2] + robot.profile.frames["scan"].xyz[2]
    for way in WAYS.values():
        assert height / math.sin(lean) - BodyOutline(robot).reach(np.array(way)) > law.config.release_distance + 0.5


def test_a_release_within_the_stop_is_refused() -> None:
    path = Path(__file__).resolve().parents[3] / "controllers" / "config" / "obstacle_stop.yaml"
    data = yaml.safe_load(path.read_text())
    for change, culprit in (({"release_distance": 0.41}, "release_distance 0.41"), ({"speed": 1.0}, "speed")):
        with pytest.raises(ConfigError, match=culprit):
            parse_config(ObstacleStopConfig, {**data, **change}, "here")
