"""Codecs of joint commands and trajectories: round trips, joint order, and whatever else arrives."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMsg
from trajectory_msgs.msg import JointTrajectoryPoint

from models.errors import JointNameError, MessageError, PoiseError, TrajectoryError
from models.nodes.messages import JointCommandCodec, doubles, trajectory_from_message, trajectory_to_message
from models.robot_model import RobotModel
from models.trajectory import validate_trajectory
from models.types import JointCommand, JointTrajectory
from tests.ros.conftest import STAMP


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
