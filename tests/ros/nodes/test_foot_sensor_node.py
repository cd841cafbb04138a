"""``foot_sensor_node``: contacts with hysteresis, centres of pressure, and silence where a sensor is silent."""

from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from std_msgs.msg import Bool

from controllers.nodes.foot_sensor_node import FootSensorNode
from models.constants import GRAVITY
from models.nodes import topics
from models.nodes.messages import WrenchCodec
from models.nodes.qos import SENSOR_QUEUE
from models.robot_model import SOLE_FRAMES, RobotModel
from tests.ros.delivery import deliver

pytestmark = pytest.mark.ros

MS = 1_000_000


class Feet:
    """The node, fed with a sample of each foot each millisecond of its stamps."""

    def __init__(self, bench: Any, model: RobotModel, **parameters: object) -> None:
        self.bench, self.weight, self.stamp = bench, model.mass * GRAVITY, 0
        self.node = bench.add(FootSensorNode, robot=model.name, diagnostics_period=10.0, **parameters)
        self.contacts: list[list[bool]] = [[], []]
        self.cops: list[list[PointStamped]] = [[], []]
        listen = bench.world.create_subscription
        for foot in range(2):
            listen(
                Bool, topics.FOOT_CONTACTS[foot], lambda m, foot=foot: self.contacts[foot].append(m.data), SENSOR_QUEUE
            )
            listen(PointStamped, topics.FOOT_COPS[foot], self.cops[foot].append, SENSOR_QUEUE)
        publishers = [*self.node._contacts, *self.node._cops]
        bench.wait(lambda: all(each.get_subscription_count() == 1 for each in publishers))
        self._codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]

    def tick(self, *shares: float, count: int = 1, cop: tuple[float, float] = (0.0, 0.0), feet: int = 2) -> None:
        """Loads as shares of the weight, at a centre of pressure, of the first so many feet."""
        for _ in range(count):
            self.stamp += MS
            for foot in range(feet):
                load = shares[foot] * self.weight
                wrench = [0.0, 0.0, load, cop[1] * load, -cop[0] * load, 0.0]
                deliver(self.node, topics.FOOT_WRENCHES[foot], self._codecs[foot].encode(self.stamp, wrench))

    def received(self) -> list[list[bool]]:
        """Contacts since the last call."""
        self.bench.spin(0.1)
        received, self.contacts[:] = [list(each) for each in self.contacts], [[], []]
        return received


def test_contacts_with_hysteresis_and_delay(bench: Any, g1: RobotModel) -> None:
    feet = Feet(bench, g1, rate=1.0)
    config = feet.node._contact
    between = 0.5 * (config.load_off + config.load_on)
    feet.tick(0.5, 0.5)
    assert feet.received() == [[True], [True]]
    feet.tick(0.5, between, count=20)
    assert feet.received() == [[], []]  # still in contact, and nothing is due
    feet.tick(1.0, 0.5 * config.load_off)
    assert feet.received() == [[], [False]]
    feet.tick(1.0, between, count=20)
    assert feet.received() == [[], []]
    blip = round(1000 * config.on_delay)
    feet.tick(0.5, 0.5, count=blip)
    feet.tick(1.0, 0.0)
    assert feet.received() == [[], []]  # too short
    feet.tick(0.5, 0.5, count=blip + 1)
    assert feet.received() == [[], [True]]


def test_centres_of_pressure_of_bearing_feet_at_their_rate(bench: Any, g1: RobotModel) -> None:
    feet = Feet(bench, g1, rate=50.0)
    feet.tick(1.0, 0.0, count=100, cop=(0.03, -0.01))
    bench.wait(lambda: len(feet.cops[0]) == 6 and len(feet.contacts[1]) == 6)
    assert feet.cops[1] == []
    point = feet.cops[0][-1]
    assert (point.header.frame_id, point.header.stamp.nanosec) == ("l_sole", 100 * MS)
    assert (point.point.x, point.point.y) == pytest.approx((0.03, -0.01))


def test_of_a_silent_foot_nothing_is_said(bench: Any, g1: RobotModel) -> None:
    feet = Feet(bench, g1)
    feet.tick(0.5, 0.5, count=50)
    feet.received()
    feet.node.before_diagnostics()
    assert feet.node.level == DiagnosticStatus.OK
    feet.tick(0.5, count=50, feet=1)
    feet.node.before_diagnostics()
    assert (feet.node.level, feet.node.message) == (DiagnosticStatus.ERROR, "silent: right")
    left, right = feet.received()
    assert set(left) == {True} and len(right) <= 1
    feet.node.before_diagnostics()  # nothing since the last report
    assert feet.node.message == "silent: left, right"
    feet.tick(0.5, 0.5, count=20)
    feet.node.before_diagnostics()
    assert feet.node.message == "detecting contacts"


def test_malformed_samples_are_refused_by_name(bench: Any, g1: RobotModel) -> None:
    feet = Feet(bench, g1)
    feet.tick(0.5, float("nan"))
    assert feet.node.counters[f"refused {topics.FOOT_WRENCHES[1]}"] == 1
    assert "wrench of element 2 is nan" in feet.node.values["last refusal"]


def test_a_robot_without_foot_sensors_is_refused(bench: Any, barefoot: Path) -> None:
    node = bench.add(FootSensorNode, robot=barefoot)
    assert not node.active
    assert "has no foot sensors" in node.message
