"""Ways in which ``poise bench graph_faults`` spoils messages: each does what it is called, and receivers say why."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState

from benchmarks.graph.spoilt_bridge import SHIFT, SPOILS, SpoiltPublisher, stamp_field
from models.errors import PoiseError
from models.nodes.messages import JointStateCodec, set_stamp, stamp_ns
from models.robot_model import RobotModel

pytestmark = pytest.mark.ros

NOW, BEGAN = 5_000_000_000, 4_999_000_000


def joint_bytes(model: RobotModel) -> bytes:
    q = np.arange(model.nj, dtype=np.float64)
    return JointStateCodec(model).encode(NOW, q, q + 100.0, q + 200.0)


def spoilt(model: RobotModel, spoil: str) -> bytes:
    return bytes(serialize_message(SPOILS[spoil](deserialize_message(joint_bytes(model), JointState), BEGAN)))


@pytest.mark.parametrize(
    ("spoil", "culprit"), [("missing", "missing"), ("extra", "tail_joint"), ("duplicate", "twice"), ("reordered", "")]
)
def test_other_names_are_refused_and_another_order_is_not(g1: RobotModel, spoil: str, culprit: str) -> None:
    codec = JointStateCodec(g1)
    if culprit:
        with pytest.raises(PoiseError, match=culprit):
            codec.decode(spoilt(g1, spoil))
        return
    for given, expected in zip(codec.decode(spoilt(g1, spoil)), codec.decode(joint_bytes(g1)), strict=True):
        np.testing.assert_array_equal(given, expected)


@pytest.mark.parametrize(
    ("spoil", "stamp"),
    [("repeated", BEGAN), ("backward", 2 * BEGAN - NOW), ("old", NOW - SHIFT), ("future", NOW + SHIFT)],
)
@pytest.mark.parametrize("kind", [JointState, Imu, Clock])
def test_stamps_are_changed_where_a_message_has_its_own(spoil: str, stamp: int, kind: type) -> None:
    message = kind()
    set_stamp(stamp_field(message), NOW)
    assert stamp_ns(stamp_field(SPOILS[spoil](message, BEGAN))) == stamp


def test_a_publisher_spoils_as_many_messages_as_requested(g1: RobotModel) -> None:
    sent: list[Any] = []
    publisher = SpoiltPublisher(SimpleNamespace(publish=sent.append), JointState)
    publisher.spoil("silent", 2)
    for _ in range(3):
        publisher.publish(joint_bytes(g1))
    assert sent == [joint_bytes(g1)]
