"""Ways in which ``poise bench graph_faults`` corrupts messages: each does what it is called, and receivers say why."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState

from benchmarks.graph.faulty_driver import CORRUPTIONS, SHIFT, CorruptingPublisher, stamp_field
from models.errors import PoiseError
from models.nodes.messages import JointStateCodec, set_stamp, stamp_ns
from models.robot_model import RobotModel

pytestmark = pytest.mark.ros

NOW, BEGAN = 5_000_000_000, 4_999_000_000


def joint_bytes(model: RobotModel) -> bytes:
    q = np.arange(model.nj, dtype=np.float64)
    return JointStateCodec(model).encode(NOW, q, q + 100.0, q + 200.0)


def corrupted(model: RobotModel, corrupt: str) -> bytes:
    return bytes(serialize_message(CORRUPTIONS[corrupt](deserialize_message(joint_bytes(model), JointState), BEGAN)))


@pytest.mark.parametrize(
    ("corrupt", "culprit"), [("missing", "missing"), ("extra", "tail_joint"), ("duplicate", "twice"), ("reordered", "")]
)
def test_other_names_are_refused_and_another_order_is_not(g1: RobotModel, corrupt: str, culprit: str) -> None:
    codec = JointStateCodec(g1)
    if culprit:
        with pytest.raises(PoiseError, match=culprit):
            codec.decode(corrupted(g1, corrupt))
        return
    for given, expected in zip(codec.decode(corrupted(g1, corrupt)), codec.decode(joint_bytes(g1)), strict=True):
        np.testing.assert_array_equal(given, expected)


@pytest.mark.parametrize(
    ("corrupt", "stamp"),
    [("repeated", BEGAN), ("backward", 2 * BEGAN - NOW), ("old", NOW - SHIFT), ("future", NOW + SHIFT)],
)
@pytest.mark.parametrize("kind", [JointState, Imu, Clock])
def test_stamps_are_changed_where_a_message_has_its_own(corrupt: str, stamp: int, kind: type) -> None:
    message = kind()
    set_stamp(stamp_field(message), NOW)
    assert stamp_ns(stamp_field(CORRUPTIONS[corrupt](message, BEGAN))) == stamp


def test_a_publisher_corrupts_as_many_messages_as_requested(g1: RobotModel) -> None:
    sent: list[Any] = []
    publisher = CorruptingPublisher(SimpleNamespace(publish=sent.append), JointState)
    publisher.corrupt("silent", 2)
    message = joint_bytes(g1)  # its padding differs each time it is made
    for _ in range(3):
        publisher.publish(message)
    assert sent == [message]
