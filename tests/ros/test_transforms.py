"""``/tf``: its bytes against an independent decoder, and its type over DDS where ``tf2_msgs`` is not installed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

from controllers.nodes.transform_topics import static_frames
from models.errors import MessageError
from models.nodes import tf_type
from models.nodes.message_text import message_text
from models.nodes.qos import EVENT
from models.nodes.tf_type import DEFINITION, TYPE_NAME, made_message_type, tf_message_type
from models.nodes.transforms import TransformsCodec
from models.robot_model import RobotModel

pytestmark = pytest.mark.ros

HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
"""Type hash of tf2_msgs/msg/TFMessage as ROS 2 nodes with the real package announce it."""

STAMP = 12_345_678_901


def decode(data: bytes) -> Any:
    """TFMessage decoded by mcap-ros2-support from the message's definition."""
    text = DEFINITION + message_text("geometry_msgs/msg/TransformStamped", header=True)
    decoder = DecoderFactory().decoder_for("cdr", Schema(1, text.encode(), "ros2msg", TYPE_NAME))
    assert decoder is not None
    return decoder(data)


def pose(transform: Any) -> list[float]:
    """Translation and quaternion."""
    t, r = transform.transform.translation, transform.transform.rotation
    return [t.x, t.y, t.z, r.x, r.y, r.z, r.w]


@pytest.mark.parametrize("frames", [[("odom", "base_link"), ("base_link", "base_footprint")], [("a", "bcd")], []])
def test_transforms_read_back(frames: list[tuple[str, str]]) -> None:
    poses = np.random.default_rng(1).normal(size=(len(frames), 7))
    codec = TransformsCodec(frames)
    codec.encode(1, poses + 1.0)
    transforms = decode(codec.encode(STAMP, list(poses))).transforms
    assert [(each.header.frame_id, each.child_frame_id) for each in transforms] == frames
    for each, expected in zip(transforms, poses, strict=True):
        assert (each.header.stamp.sec, each.header.stamp.nanosec) == (12, 345_678_901)
        np.testing.assert_array_equal(pose(each), expected)


def test_the_type_made_here_is_an_ordinary_tf_message(bench: Any) -> None:
    kind = made_message_type()
    received: list[bytes] = []
    publisher = bench.world.create_publisher(kind, "/tf", EVENT)
    bench.world.create_subscription(kind, "/tf", received.append, EVENT, raw=True)
    bench.wait(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(TransformsCodec([("odom", "base_link")]).encode(STAMP, [np.arange(7.0)]))
    bench.wait(lambda: received)
    np.testing.assert_array_equal(pose(decode(received[0]).transforms[0]), np.arange(7.0))
    infos = bench.world.get_publishers_info_by_topic("/tf")
    assert {(info.topic_type, str(info.topic_type_hash)) for info in infos} == {(TYPE_NAME, HASH)}
    with pytest.raises(TypeError, match="as bytes only"):
        kind()
    with pytest.raises(TypeError):
        publisher.publish(TransformStamped())


def test_where_the_type_cannot_be_made_the_reason_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tf_type, "get_rmw_implementation_identifier", lambda: "rmw_other")
    made_message_type.cache_clear()
    with pytest.raises(MessageError, match="not for rmw_other"):
        made_message_type()


@pytest.mark.parametrize("what", ["_DONOR_NAME", "_INTROSPECTION"])
def test_an_unknown_layout_is_refused(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    monkeypatch.setattr(tf_type, what, b"something else")
    made_message_type.cache_clear()
    with pytest.raises(MessageError, match="unknown way"):
        made_message_type()


def test_a_wrong_hash_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tf_type, "type_hash", lambda description: bytes(32))
    made_message_type.cache_clear()
    with pytest.raises(MessageError, match="unknown way"):
        made_message_type()


def test_the_installed_message_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys
    from types import ModuleType

    package, messages = ModuleType("tf2_msgs"), ModuleType("tf2_msgs.msg")
    messages.TFMessage = TransformStamped  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tf2_msgs", package)
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", messages)
    tf_message_type.cache_clear()
    assert tf_message_type() is TransformStamped
    tf_message_type.cache_clear()


def test_the_static_frames_make_one_tree_with_the_links(robot: RobotModel) -> None:
    """Every frame has one parent, and ``robot_state_publisher`` brings the links."""
    frames = static_frames(robot)
    children = [child for _, child, _ in frames]
    assert len(set(children)) == len(children)
    links = {frame.name for frame in robot.pin.frames if frame.type.name == "BODY"}
    root = robot.profile.base_link
    assert {parent for parent, _, _ in frames} <= links | {"base_link"}
    assert set(children) & links <= {root}
    assert {"l_sole", "r_sole", "imu", "torso", "gaze"} <= set(children) | links
    assert root == "base_link" or ("base_link", root) in {(parent, child) for parent, child, _ in frames}
    for _, child, where in frames:
        if child in ("l_sole", "r_sole"):
            sole = robot.profile.feet.left if child == "l_sole" else robot.profile.feet.right
            np.testing.assert_allclose(where[:3], sole.xyz, atol=1e-12)
