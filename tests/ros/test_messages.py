"""Codecs against the real serialiser: round trips, joint order, and every malformation named."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import UInt8MultiArray
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMsg
from trajectory_msgs.msg import JointTrajectoryPoint

from models.errors import JointNameError, MessageError, PoiseError, TrajectoryError
from models.nodes.cdr import Markers, Template, padding
from models.nodes.messages import (
    ImuCodec,
    JointCommandCodec,
    JointStateCodec,
    WrenchCodec,
    doubles,
    stamp_ns,
    trajectory_from_message,
    trajectory_to_message,
)
from models.nodes.odometry import OdometryCodec, contacts_from_message, contacts_to_bytes
from models.robot_model import RobotModel
from models.trajectory import validate_trajectory
from models.types import JointCommand, JointTrajectory
from tests.support import standing

STAMP = 12_345_678_901


@pytest.fixture
def values(g1: RobotModel) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(3, g1.nj))


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


def _spoil(message: Any, how: str) -> None:
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
    _spoil(message, how)
    with pytest.raises((JointNameError, MessageError), match=culprit):
        JointStateCodec(g1).decode(bytes(serialize_message(message)))


@pytest.mark.parametrize("size", [0, 3, 11, 200])
def test_truncated_bytes_are_refused(g1: RobotModel, values: np.ndarray, size: int) -> None:
    data = JointStateCodec(g1).encode(STAMP, *values)[:size]
    with pytest.raises(MessageError):
        JointStateCodec(g1).decode(data)


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


def test_command_round_trip_shuffle_and_trajectory(g1: RobotModel, values: np.ndarray) -> None:
    codec = JointCommandCodec(g1)
    data = codec.encode(STAMP, JointCommand(*values))
    stamp, command = codec.decode(data)
    assert stamp == STAMP
    assert isinstance(command, JointCommand)
    np.testing.assert_array_equal([command.q, command.v, command.tau], values)

    order = np.random.default_rng(3).permutation(g1.nj)
    message = deserialize_message(data, JointTrajectoryMsg)
    message.joint_names = [g1.joint_names[i] for i in order]
    for field, row in zip(("positions", "velocities", "effort"), values, strict=True):
        setattr(message.points[0], field, doubles(row[order]))
    _, shuffled = codec.decode(bytes(serialize_message(message)))
    assert isinstance(shuffled, JointCommand)
    np.testing.assert_array_equal(shuffled.tau, values[2])

    message.points.append(JointTrajectoryPoint(positions=doubles(values[0])))
    message.points[0].velocities, message.points[0].effort = [], []
    message.points[1].time_from_start.sec = 1
    _, trajectory = codec.decode(bytes(serialize_message(message)))
    assert isinstance(trajectory, JointTrajectory)
    assert trajectory.velocities is None


@pytest.mark.parametrize("field", ["positions", "velocities", "effort"])
def test_nan_in_a_command_is_named(g1: RobotModel, values: np.ndarray, field: str) -> None:
    values[("positions", "velocities", "effort").index(field), 3] = math.nan
    with pytest.raises(MessageError, match=f"{field} of {g1.joint_names[3]} is nan"):
        JointCommandCodec(g1).decode(JointCommandCodec(g1).encode(STAMP, JointCommand(*values)))


def test_trajectory_round_trip_and_ragged_points() -> None:
    trajectory = JointTrajectory(("a", "b"), np.array([0.0, 1.5]), np.eye(2), np.ones((2, 2)))
    message = trajectory_to_message(trajectory)
    back = trajectory_from_message(message)
    np.testing.assert_array_equal(back.times, trajectory.times)
    np.testing.assert_array_equal(back.positions, trajectory.positions)
    assert back.velocities is not None
    assert back.efforts is None
    message.points[1].positions = [1.0]
    with pytest.raises(TrajectoryError, match="positions: point 1 has 1 values for 2 joints"):
        trajectory_from_message(message)
    message.joint_names = ["a", "a"]
    with pytest.raises(JointNameError, match="'a' is given twice"):
        trajectory_from_message(message)


def test_trajectories_that_name_no_joint_are_refused(g1: RobotModel) -> None:
    for message in (JointTrajectoryMsg(), JointTrajectoryMsg(points=[JointTrajectoryPoint()])):
        data = bytes(serialize_message(message))
        with pytest.raises(TrajectoryError, match="joint_names: empty"):
            JointCommandCodec(g1).decode(data)


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_arrives_is_read_or_refused(g1: RobotModel, data: st.DataObject) -> None:
    """Sizes that do not fit, empty fields, numbers that are none, flipped and missing bytes: only ``PoiseError``."""
    sizes, numbers = st.integers(0, 3), st.floats(width=64)
    names = st.lists(st.sampled_from([*g1.joint_names[:3], "tail_joint", ""]), max_size=4)
    message = JointTrajectoryMsg(joint_names=data.draw(names))
    for _ in range(data.draw(sizes)):
        point = JointTrajectoryPoint()
        for field in ("positions", "velocities", "accelerations", "effort"):
            size = data.draw(st.one_of(st.just(len(message.joint_names)), sizes))
            setattr(point, field, data.draw(st.lists(numbers, min_size=size, max_size=size)))
        point.time_from_start.sec = data.draw(st.integers(-(2**31), 2**31 - 1))
        message.points.append(point)
    whole = bytearray(serialize_message(message))
    for _ in range(data.draw(st.integers(0, 3))):
        whole[data.draw(st.integers(4, len(whole) - 1))] = data.draw(st.integers(0, 255))
    received = bytes(whole[: data.draw(st.integers(0, len(whole)))] if data.draw(st.booleans()) else whole)
    try:
        _, command = JointCommandCodec(g1).decode(received)
        if isinstance(command, JointTrajectory):
            validate_trajectory(command, g1, start_q=g1.posture("stand"))
    except PoiseError as error:
        assert str(error)


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
    with pytest.raises(MessageError, match="frames are"):
        OdometryCodec().decode(bytes(serialize_message(message)))


def test_odometry_with_a_quaternion_that_is_not_of_unit_length_is_refused(g1: RobotModel) -> None:
    q = g1.standing_configuration()
    q[3:7] *= 1.01
    state = standing(g1, 1.0, q=q)
    with pytest.raises(MessageError, match="quaternion of norm"):
        OdometryCodec().decode(OdometryCodec().encode(STAMP, state))


@pytest.mark.parametrize("frame", ["", "i", "im", "imu", "imu_"])
def test_padding_carries_nothing(frame: str) -> None:
    """What the serialiser leaves in the padding decides neither the message nor the fast path."""
    message = Imu()
    message.header.frame_id = frame
    marks = Markers().take(3)
    message.angular_velocity.x, message.angular_velocity.y, message.angular_velocity.z = marks.tolist()
    data = bytes(serialize_message(message))
    free = padding(message, len(data))
    assert np.flatnonzero(free).tolist() == list(range(17 + len(frame), 20 if len(frame) < 4 else 28))
    template = Template(message, [marks])
    for fill in (0, 255):
        filled = np.where(free, fill, np.frombuffer(data, np.uint8)).astype(np.uint8).tobytes()
        assert deserialize_message(filled, Imu) == message
        assert template.matches(filled)


def test_every_byte_that_means_something_is_compared(g1: RobotModel, values: np.ndarray) -> None:
    """The fast path takes a message only if slow decoding would read the same: one flipped byte must not slip by."""
    message = _message(g1, values)
    marks = Markers()
    slots = [marks.take(g1.nj) for _ in range(3)]
    message.position, message.velocity, message.effort = (doubles(slot) for slot in slots)
    template = Template(message, slots)
    data = template.pack(0, values)
    free = padding(message, len(data))
    start = data.find(g1.joint_names[0].encode())
    for i in range(start, data.find(g1.joint_names[3].encode())):
        flipped = data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :]
        assert template.matches(flipped) == bool(free[i])


def test_template_refuses_a_message_without_its_markers() -> None:
    with pytest.raises(MessageError, match="not contiguous"):
        Template(Imu(), [Markers().take(3)])
