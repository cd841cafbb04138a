"""Writes a run of the closed loop as the topics of the graph, with all that a replay needs; without a graph."""

from __future__ import annotations

import zlib
from pathlib import Path

from rclpy.serialization import serialize_message
from std_msgs.msg import String

from bridge.mcap_log import McapLog
from bridge.mujoco_plant import MujocoPlant
from bridge.run_topics import DESCRIPTION, EVENTS, ROBOT, TYPES
from models.nodes import topics
from models.nodes.messages import (
    ImuCodec,
    JointCommandCodec,
    JointStateCodec,
    WrenchCodec,
    to_ns,
    trajectory_to_message,
)
from models.nodes.odometry import OdometryCodec
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import ControlResult, JointTrajectory, Mode, RobotState, SensorData

ODOMETRY_PERIOD = 0.01
"""Time between two odometries, estimated and true, as in the graph [s]."""


class LoopRecorder:
    """What ``Lockstep`` tells as it goes becomes messages; a new start begins the file anew.

    The time of the log is that of the tick; ``header.stamp`` of the sensors is their own, which differs where they are
    late. Sensors are as the laws got them: calibrated, and with the faults that were injected.

    Args:
        robot: The robot.
        path: Where the file appears at ``close``.

    Raises:
        PoiseError: It cannot be written.
    """

    def __init__(self, robot: RobotModel, path: Path) -> None:
        self._robot, self._path = robot, path
        self._joints, self._command, self._imu = JointStateCodec(robot), JointCommandCodec(robot), ImuCodec("imu")
        self._feet = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._odometry = OdometryCodec()
        self._log: McapLog | None = self._begin()

    def _begin(self) -> McapLog:
        """A file with its topics, and with what it is about."""
        log = McapLog(self._path)
        for topic in (
            *topics.sensor_topics(self._robot),
            *(topics.JOINT_COMMAND, topics.MODE, topics.ODOM, topics.GROUND_TRUTH, topics.MOTION_TRAJECTORY),
            *(topics.APPLIED, topics.ROBOT_DESCRIPTION, EVENTS),
        ):
            log.announce(f"/{topic}", TYPES[topic])
        log.describe(DESCRIPTION, {ROBOT: self._robot.name})
        urdf = self._robot.urdf.read_text(encoding="utf-8")
        log.add(f"/{topics.ROBOT_DESCRIPTION}", bytes(serialize_message(String(data=urdf))), 0)
        self._now = 0
        self._mode: Mode | None = None
        self._next_odometry = 0.0
        return log

    def _add(self, topic: str, data: bytes, stamp: int) -> None:
        if self._log is not None:
            self._log.add(f"/{topic}", data, stamp)

    def _say(self, topic: str, text: str, stamp: int) -> None:
        self._add(topic, bytes(serialize_message(String(data=text))), stamp)

    def start(self) -> None:
        """The estimator has started; what was recorded of an earlier run is dropped."""
        if self._log is None:
            return
        if self._now:
            self._log.discard()
            self._log = self._begin()

    def motion(self, trajectory: JointTrajectory) -> int:
        """A law has begun to follow a motion; returns the number for its note."""
        data = bytes(serialize_message(trajectory_to_message(trajectory)))
        self._add(topics.MOTION_TRAJECTORY, data, self._now)
        return zlib.crc32(data)

    def event(self, text: str) -> None:
        """Something happened."""
        self._say(EVENTS, text, self._now)

    def tick(
        self,
        plant: MujocoPlant,
        sensors: SensorData,
        state: RobotState,
        result: ControlResult | None,
        mode: Mode,
        note: str,
    ) -> None:
        """A tick of the laws is over.

        Args:
            plant: The simulated robot, for the time and for what is true.
            sensors: What the estimator got.
            state: What it made of it.
            result: What the law in charge answered; None where none is.
            mode: Mode of the robot.
            note: What the laws were told; empty for nothing.
        """
        if self._log is None:
            return
        self._now = now = to_ns(plant.t)
        stamp = to_ns(sensors.t)
        self._add(topics.IMU_RAW, self._imu.encode(stamp, sensors.gyro, sensors.accel), now)
        for foot, topic in enumerate(topics.foot_wrenches(self._robot)):
            self._add(topic, self._feet[foot].encode(stamp, sensors.wrenches[foot]), now)
        self._add(topics.JOINT_STATES, self._joints.encode(stamp, sensors.q, sensors.v, sensors.tau), now)
        if mode is not self._mode:
            self._mode = mode
            self._say(topics.MODE, mode.value, now)
        if result is not None:
            self._add(topics.JOINT_COMMAND, self._command.encode(now, result.command), now)
        if note:
            self._say(topics.APPLIED, note, now)
        if plant.t >= self._next_odometry:
            self._next_odometry = plant.t + ODOMETRY_PERIOD
            self._add(topics.ODOM, self._odometry.encode(now, state), now)
            self._add(topics.GROUND_TRUTH, self._odometry.encode(now, plant.truth), now)

    def close(self) -> dict[str, int]:
        """Complete the file and give it its name; returns the number of messages by topic. Nothing is written later."""
        if self._log is None:
            return {}
        log, self._log = self._log, None
        log.close()
        return log.counts

    def discard(self) -> None:
        """Leave no file."""
        if self._log is not None:
            self._log.discard()
            self._log = None
