"""Codecs of what is measured and estimated, against the real serialiser: each malformation is named."""

import math
import struct
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import UInt8MultiArray

from models.errors import JointNameError, MessageError
from models.nodes.cdr import STAMP_OFFSET, Template
from models.nodes.messages import ImuCodec, JointCommandCodec, JointStateCodec, WrenchCodec, doubles, stamp_ns
from models.nodes.odometry import OdometryCodec, contacts_from_message, contacts_to_bytes
from models.robot_model import RobotModel
from models.types import JointCommand
from tests.ros.conftest import STAMP
from tests.support import standing


def _message(g1: RobotModel, values: np.ndarray) -> JointState:
    message = JointState(name=list(g1.joint_names))
    message.position, message.velocity, message.effort = (doubles(row) for row in values)
    message.header.stamp.sec, message.header.stamp.nanosec = 12, 345_678_901
    return message


def test_joint_states_round_trip_through_the_real_serialiser(g1: RobotModel, values: np.ndarray) -> None:
    codec = JointStateCodec(g1)
    data = codec.encode(STAMP, *values)
    message = deserialize_message(data, JointState)
    assert message == _message(g1, values)
    assert stamp_ns(message.header.stamp) == STAMP
    assert list(message.name) == list(g1.joint_names)
    np.testing.assert_array_equal(message.velocity, values[1])
    stamp, *decoded = codec.decode(data)
    assert stamp == STAMP
    np.testing.assert_array_equal(decoded, values)


def test_decoded_arrays_are_not_overwritten_by_the_next_message(g1: RobotModel, values: np.ndarray) -> None:
    codec = JointStateCodec(g1)
    _, q, _, _ = codec.decode(codec.encode(1, *values))
    codec.decode(codec.encode(2, *(values + 1.0)))
    np.testing.assert_array_equal(q, values[0])


def test_shuffled_names_give_identical_values(g1: RobotModel, values: np.ndarray) -> None:
    order = np.random.default_rng(2).permutation(g1.nj)
    message = _message(g1, values[:, order])
    message.name = [g1.joint_names[i] for i in order]
    _, *decoded = JointStateCodec(g1).decode(bytes(serialize_message(message)))
    np.testing.assert_array_equal(decoded, values)


def test_frame_id_does_not_matter_for_joint_states(g1: RobotModel, values: np.ndarray) -> None:
    message = _message(g1, values)
    message.header.frame_id = "world"
    stamp, *decoded = JointStateCodec(g1).decode(bytes(serialize_message(message)))
    assert stamp == STAMP
    np.testing.assert_array_equal(decoded, values)


def _corrupt(message: Any, how: str) -> None:
    knee = list(message.name).index("left_knee_joint")
    names = list(message.name)
    if how == "missing":
        message.name = names[:-1]
        for field in ("position", "velocity", "effort"):
            setattr(message, field, getattr(message, field)[:-1])
    elif how == "unknown":
        message.name = [*names[:-1], "tail_joint"]
    elif how == "duplicate":
        message.name = [*names[:-1], "left_knee_joint"]
    elif how == "short":
        message.velocity = message.velocity[:-1]
    elif how == "empty":
        message.name, message.position, message.velocity, message.effort = [], [], [], []
    else:
        message.position[knee] = {"nan": math.nan, "inf": math.inf}[how]


@pytest.mark.parametrize(
    ("how", "culprit"),
    [
        ("missing", "is missing"),
        ("unknown", "tail_joint"),
        ("duplicate", "'left_knee_joint' is given twice"),
        ("short", "velocity: 28 values for 29 names"),
        ("empty", "is missing"),
        ("nan", "position of left_knee_joint is nan"),
        ("inf", "position of left_knee_joint is inf"),
    ],
)
def test_malformed_joint_states_name_the_culprit(g1: RobotModel, values: np.ndarray, how: str, culprit: str) -> None:
    message = _message(g1, values)
    _corrupt(message, how)
    with pytest.raises((JointNameError, MessageError), match=culprit):
        JointStateCodec(g1).decode(bytes(serialize_message(message)))


@pytest.mark.parametrize("size", [0, 3, 11, 200])
def test_truncated_bytes_are_refused(g1: RobotModel, values: np.ndarray, size: int) -> None:
    data = JointStateCodec(g1).encode(STAMP, *values)[:size]
    with pytest.raises(MessageError):
        JointStateCodec(g1).decode(data)


@pytest.mark.parametrize(("sec", "nanosec"), [(-1, 0), (5, 1_000_000_000)])
def test_stamps_that_are_no_time_are_refused_but_read_from_logs(
    g1: RobotModel, values: np.ndarray, sec: int, nanosec: int
) -> None:
    joints, commands = JointStateCodec(g1), JointCommandCodec(g1)
    for codec, data in (
        (joints, joints.encode(STAMP, *values)),
        (commands, commands.encode(STAMP, JointCommand(*values))),
        (OdometryCodec(), OdometryCodec().encode(STAMP, standing(g1))),
    ):
        bad = bytearray(data)
        struct.pack_into("<iI", bad, STAMP_OFFSET, sec, nanosec)
        with pytest.raises(MessageError, match=f"header.stamp: {sec} s and {nanosec} ns"):
            codec.decode(bytes(bad))
        if codec is joints:
            assert joints.read(bytes(bad))[0] == sec * 1_000_000_000 + nanosec


def test_imu_and_wrench_round_trip_and_refusals() -> None:
    imu, foot = ImuCodec("imu"), WrenchCodec("l_sole")
    data = imu.encode(STAMP, np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]))
    message = deserialize_message(data, Imu)
    assert message.orientation_covariance[0] == -1.0
    assert message.linear_acceleration.z == 6.0
    stamp, gyro, accel = imu.decode(data)
    assert (stamp, *gyro, *accel) == (STAMP, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    stamp, wrench = foot.decode(foot.encode(STAMP, np.arange(6.0)))
    assert (stamp, *wrench) == (STAMP, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0)
    with pytest.raises(MessageError, match="frame_id is 'l_sole', expected 'r_sole'"):
        WrenchCodec("r_sole").decode(foot.encode(STAMP, np.arange(6.0)))
    with pytest.raises(MessageError, match="linear_acceleration of element 1 is nan"):
        imu.decode(imu.encode(STAMP, np.zeros(3), np.array([0.0, math.nan, 9.8])))


def test_imu_with_an_orientation_is_still_read() -> None:
    message = Imu()
    message.header.frame_id = "imu"
    message.orientation.w = 1.0
    message.angular_velocity.x = 0.25
    assert ImuCodec("imu").decode(bytes(serialize_message(message)))[1][0] == 0.25


def test_odometry_and_contacts_round_trip(g1: RobotModel) -> None:
    v = np.arange(g1.nv, dtype=np.float64)
    state = standing(g1, 1.0, v=v, shares=(1.0, 0.0))
    stamp, pose, twist = OdometryCodec().decode(OdometryCodec().encode(STAMP, state))
    assert stamp == STAMP
    np.testing.assert_array_equal(pose, state.q[:7])
    np.testing.assert_array_equal(twist, v[:6])
    message = deserialize_message(contacts_to_bytes(state.contacts), UInt8MultiArray)
    assert contacts_from_message(message) == (True, False)
    message.layout.dim[0].label = "right"
    with pytest.raises(MessageError, match="labels"):
        contacts_from_message(message)


def test_odometry_carries_the_covariance_it_was_given(g1: RobotModel) -> None:
    state = standing(g1, 1.0, v=np.arange(g1.nv, dtype=np.float64))
    codec = OdometryCodec()
    message = deserialize_message(codec.encode(STAMP, state), Odometry)
    assert not message.pose.covariance.any()
    pose, twist = np.arange(36.0).reshape(6, 6), 100.0 + np.arange(36.0).reshape(6, 6)
    codec.set_covariance(pose, twist)
    message = deserialize_message(codec.encode(STAMP, state), Odometry)
    np.testing.assert_array_equal(np.reshape(message.pose.covariance, (6, 6)), pose)
    np.testing.assert_array_equal(np.reshape(message.twist.covariance, (6, 6)), twist)
    np.testing.assert_array_equal(OdometryCodec().decode(codec.encode(STAMP, state))[2], state.v[:6])
    message.pose.pose.position.x = 4.0
    message.child_frame_id = "base"
    with pytest.raises(MessageError, match="child_frame_id is 'base', expected 'base_link'"):
        OdometryCodec().decode(bytes(serialize_message(message)))


def test_odometry_with_a_quaternion_that_is_not_of_unit_length_is_refused(g1: RobotModel) -> None:
    q = g1.standing_configuration()
    q[3:7] *= 1.01
    state = standing(g1, 1.0, q=q)
    with pytest.raises(MessageError, match="quaternion of norm"):
        OdometryCodec().decode(OdometryCodec().encode(STAMP, state))


@pytest.mark.parametrize("frame", ["", "i", "im", "imu", "imu_"])
def test_padding_carries_nothing(frame: str) -> None:
    """What the serialiser leaves in the padding decides neither the message nor whether it matches."""
    message = Imu()
    message.header.frame_id = frame
    template = Template(message, ["angular_velocity"])
    data = template.pack(0, [np.arange(3.0)])
    padding = list(range(17 + len(frame), 20 if len(frame) < 4 else 28))
    for fill in (0, 255, 0):
        filled = bytearray(data)
        for i in padding:
            filled[i] = fill
        (rate,) = template.unpack(bytes(filled)) or [None]
        np.testing.assert_array_equal(rate, np.arange(3.0))


def test_every_byte_that_means_something_is_compared(g1: RobotModel, values: np.ndarray) -> None:
    """The fast path takes a message only if slow decoding would read the same: one flipped byte must not slip by."""
    template = Template(_message(g1, values), ["position", "velocity", "effort"])
    data = template.pack(0, values)
    whole = deserialize_message(data, JointState)
    start = data.find(g1.joint_names[0].encode())
    matched = 0
    for i in range(start, data.find(g1.joint_names[3].encode())):
        flipped = data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :]
        try:
            same = bool(deserialize_message(flipped, JointState) == whole)
        except Exception:  # a length that does not fit
            same = False
        assert template.matches(flipped) == same
        matched += same
    assert 0 < matched < 9  # the padding between the names alone


def test_template_refuses_a_message_without_its_markers() -> None:
    with pytest.raises(MessageError, match="not contiguous"):
        Template(Imu(), ["angular_velocity", "angular_velocity"])  # the first markers are overwritten
