"""The topic ``scan``: what goes over unchanged, what is refused by name, and that the obstacle stop hears the rest."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import LaserScan

from controllers.commands.obstacle_stop import ObstacleStop
from controllers.nodes.command_topics import ScanTopic
from models.errors import MessageError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import to_ns
from models.nodes.perception import scan_from_message, scan_to_message
from models.nodes.qos import SENSOR
from models.robot_model import RobotModel
from models.scan import Scan
from tests.scans import empty, wall

pytestmark = pytest.mark.ros


class Listener(PoiseNode):
    """Nothing but the obstacle stop and its topic."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("listener", **kwargs)
        self.now = 10.0

    def configure(self) -> None:
        self.law = ObstacleStop(self.model)
        self.topic = ScanTopic(self, self.law, lambda: self.now)


def _message(scan: Scan) -> Any:
    return scan_to_message(to_ns(scan.t), scan, 0.1)


def test_a_scan_goes_over_unchanged(g1: RobotModel) -> None:
    sent = wall(g1, 12.345678901, 1.7)
    sent.ranges[:3] = -math.inf, math.nan, math.inf
    message = _message(sent)
    assert (message.header.frame_id, message.scan_time, message.time_increment) == ("scan", pytest.approx(0.1), 0.0)
    got = scan_from_message(message)
    assert got.t == sent.t
    np.testing.assert_array_equal(got.ranges, sent.ranges.astype(np.float32))
    for name in ("angle_min", "angle_increment", "angle_max", "range_min", "range_max"):
        assert getattr(got, name) == pytest.approx(getattr(sent, name), abs=1e-4), name


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        ({"angle_max": 1.0}, "ranges: 720 readings end at"),
        ({"angle_max": math.nan}, "ranges: 720 readings end at"),
        ({"angle_min": math.nan}, "angle_min is nan"),
        ({"angle_increment": 0.0}, "angle_increment is 0"),
        ({"ranges": [1.0] * 700}, "ranges: 700 readings end at"),
        ({"intensities": [1.0] * 3}, "intensities: 3 values for 720 ranges"),
    ],
)
def test_fields_that_do_not_match_are_refused(change: dict[str, Any], culprit: str) -> None:
    message = _message(empty(1.0))
    for name, value in change.items():
        setattr(message, name, value)
    with pytest.raises(MessageError, match=culprit):
        scan_from_message(message)
    message = _message(empty(1.0))
    message.header.frame_id = "laser"
    with pytest.raises(MessageError, match="'laser' instead of 'scan'"):
        scan_from_message(message)


def test_the_stop_hears_scans_and_refuses_others_by_name(bench: Any, g1: RobotModel) -> None:
    node = bench.add(Listener)
    publisher = bench.world.create_publisher(LaserScan, topics.SCAN, SENSOR)
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    velocity, key = (0.2, 0.0, 0.0), f"refused {topics.SCAN}"

    def refused(scan: Scan, culprit: str) -> None:
        count = node.counters[key]
        publisher.publish(_message(scan))
        bench.wait(lambda: node.counters[key] == count + 1)
        assert culprit in node.values["last refusal"]

    publisher.publish(_message(wall(g1, 10.0, 0.4)))
    bench.wait(lambda: "ahead" in node.law.limit(velocity, 10.0)[1])
    refused(replace(empty(10.1), angle_increment=0.0), "angle_increment is 0")
    refused(empty(10.0), "t: 10.000000 s is not after")
    refused(empty(9.4), "header.stamp: 9.400 s, while /clock is at 10.000 s")
    refused(empty(10.6), "header.stamp: 10.600 s, while /clock is at 10.000 s")
    assert "ahead" in node.law.limit(velocity, 10.0)[1]
    node.now = 0.0  # nothing received from the clock yet
    publisher.publish(_message(empty(0.1)))
    bench.spin(0.1)
    assert node.counters[key] == 4
    node.now = 12.0
    publisher.publish(_message(empty(12.0)))
    bench.wait(lambda: node.law.limit((0.0, 0.2, 0.0), 12.0)[1] == "")
    node.now = 1.0  # the bridge was restarted, and with it the clock
    publisher.publish(_message(empty(1.0)))
    bench.wait(lambda: node.law.limit(velocity, 1.0)[1] == "")
    assert node.counters[key] == 4
