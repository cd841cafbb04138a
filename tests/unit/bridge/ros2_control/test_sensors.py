"""Broadcasters' messages to sensor data: order of the joints, frames, and what is refused, by name."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, JointState

from bridge.plants.ros2_control.sensors import ImuDecoder, JointStateDecoder, WrenchDecoder
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import Vector

pytestmark = pytest.mark.ros


def joint_state(model: RobotModel, q: Vector, *, seed: int = 0, extra: tuple[str, ...] = ()) -> Any:
    """Joints in a random order, velocities 10 q, torques 100 q; a further joint has 7 everywhere."""
    names = [*model.joint_names, *extra]
    order = np.random.default_rng(seed).permutation(len(names))
    values = np.concatenate([q, np.full(len(extra), 7.0)])[order]
    message = JointState(name=[names[i] for i in order])
    message.header.stamp.sec, message.header.stamp.nanosec = 5, 7
    message.position, message.velocity, message.effort = (list(values * k) for k in (1.0, 10.0, 100.0))
    return message


def test_joints_of_any_order_are_in_that_of_the_robot(robot: RobotModel) -> None:
    decoder = JointStateDecoder(robot)
    for seed in (1, 1, 2):  # the same layout again, then another one
        q = np.random.default_rng(10 + seed).normal(size=robot.nj)
        message = joint_state(robot, q, seed=seed, extra=("a_gripper_joint", "z_wheel_joint"))
        stamp, *found = decoder.decode(serialize_message(message))
        assert stamp == 5_000_000_007
        for values, factor in zip(found, (1.0, 10.0, 100.0), strict=True):
            np.testing.assert_allclose(values, factor * q)


def missing(message: Any) -> None:
    at = message.name.index("left_knee_joint")
    for values in (message.name, message.position, message.velocity, message.effort):
        del values[at]


def twice(message: Any) -> None:
    message.name[message.name.index("left_knee_joint")] = "right_knee_joint"


def nan_torque(message: Any) -> None:
    message.effort[message.name.index("left_knee_joint")] = np.nan


BAD: dict[str, tuple[Callable[[Any], object], str]] = {
    "missing": (missing, "joint 'left_knee_joint' is missing"),
    "twice": (twice, "'left_knee_joint' is missing"),
    "again": (lambda m: m.name.__setitem__(0, m.name[1]), "is"),
    "nan": (nan_torque, "effort of left_knee_joint is nan: the hardware must export the state interface 'effort'"),
    "no velocities": (lambda m: setattr(m, "velocity", []), "velocity: 0 values for 29 names"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("first", [True, False])
def test_a_bad_joint_state_is_refused_by_name(g1: RobotModel, name: str, first: bool) -> None:
    decoder, message = JointStateDecoder(g1), joint_state(g1, np.zeros(g1.nj))
    if not first:
        decoder.decode(serialize_message(message))
    act, reason = BAD[name]
    act(message)
    with pytest.raises(PoiseError, match=reason):
        decoder.decode(serialize_message(message))


def imu(frame: str) -> bytes:
    message = Imu()
    message.header.frame_id = frame
    message.angular_velocity.x, message.linear_acceleration.z = 1.0, 9.81
    message.orientation.x = np.nan  # not measured
    return bytes(serialize_message(message))


def test_the_imu_is_turned_to_the_axes_of_the_profile(talos: RobotModel) -> None:
    """TALOS: the profile's frame ``imu`` is at the link ``imu_link`` and has the axes of the torso."""
    frames = [talos.pin.frames[i].placement for i in (talos.frame_id("imu"), talos.pin.getFrameId("imu_link"))]
    rotation = frames[0].rotation.T @ frames[1].rotation
    assert not np.allclose(rotation, np.eye(3))
    _, gyro, accel = ImuDecoder(talos, 0.01).decode(imu("imu_link"))
    np.testing.assert_allclose(gyro, rotation @ (1.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(accel, rotation @ (0.0, 0.0, 9.81), atol=1e-12)
    _, gyro, accel = ImuDecoder(talos, 0.01).decode(imu("imu"))
    np.testing.assert_allclose((*gyro, *accel), (1.0, 0.0, 0.0, 0.0, 0.0, 9.81))


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        ("imu_of_another", "'imu_of_another' is not a frame of robot 'g1'"),
        ("torso_link", "'torso_link' moves relative to frame 'imu'"),
        ("pelvis", "'pelvis' is 95 mm from frame 'imu' of 'g1'; set frames.imu"),
    ],
)
def test_an_imu_elsewhere_is_refused(g1: RobotModel, frame: str, reason: str) -> None:
    with pytest.raises(PoiseError, match=reason):
        ImuDecoder(g1, 0.01).decode(imu(frame))


def wrench(frame: str) -> bytes:
    message = WrenchStamped()
    message.header.frame_id = frame
    force = message.wrench.force
    force.x, force.y, force.z, message.wrench.torque.x = 10.0, 20.0, 300.0, 3.0
    return bytes(serialize_message(message))


def test_a_wrench_at_the_ankle_is_moved_to_the_sole(g1: RobotModel) -> None:
    """The ankle is 35 mm above the sole: r x f is added to the moment."""
    _, found = WrenchDecoder(g1, 0).decode(wrench("left_ankle_roll_link"))
    moment = np.cross((0.0, 0.0, 0.035), (10.0, 20.0, 300.0)) + np.array((3.0, 0.0, 0.0))
    np.testing.assert_allclose(found, (10.0, 20.0, 300.0, *moment), atol=1e-9)
    _, found = WrenchDecoder(g1, 0).decode(wrench("l_sole"))
    np.testing.assert_allclose(found, (10.0, 20.0, 300.0, 3.0, 0.0, 0.0), atol=1e-9)
    with pytest.raises(PoiseError, match="'left_ankle_roll_link' moves relative to frame 'r_sole'"):
        WrenchDecoder(g1, 1).decode(wrench("left_ankle_roll_link"))
