"""Records a run of the closed loop as topics of the graph, with all inputs of a replay; no graph is needed."""

import zlib
from pathlib import Path

from rclpy.serialization import serialize_message
from std_msgs.msg import String

from bridge.plants.mujoco import MujocoPlant
from bridge.record.mcap_log import DESCRIPTION, EVENTS, ROBOT, TYPES, McapLog
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

ODOMETRY_PERIOD = 0.01  #: Period of the estimated and the true odometry, as in the graph [s]


class LoopRecorder:
    """Converts the events of ``Lockstep`` to messages; a new start discards them, ``close`` completes the file.

    Log times are those of the ticks; ``header.stamp`` of the sensors is the sampling time, which is earlier with
    latency. Sensors are as the laws received them: calibrated, and with the injected faults. ``PoiseError`` when the
    file cannot be written.
    """

    def __init__(self, robot: RobotModel, path: Path) -> None:
        self._robot, self._path = robot, path
        self._joints, self._command, self._imu = JointStateCodec(robot), JointCommandCodec(robot), ImuCodec("imu")
        self._feet = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._odometry = OdometryCodec()
        self._log: McapLog | None = self._begin()

    def _begin(self) -> McapLog:
        log = McapLog(self._path)
        for topic in (
            *topics.sensor_topics(self._robot),
            *(topics.JOINT_SETPOINTS, topics.MODE, topics.ODOM, topics.GROUND_TRUTH, topics.MOTION_TRAJECTORY),
            *(topics.APPLIED, topics.ROBOT_DESCRIPTION, EVENTS),
        ):
            log.announce(f"/{topic}", TYPES[topic], latched=topic in (topics.MODE, topics.ROBOT_DESCRIPTION))
        log.describe(DESCRIPTION, {ROBOT: self._robot.name})
        urdf = self._robot.description
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
        """Begin a run when the estimator starts; an earlier run is discarded."""
        if self._log is None:
            return
        if self._now:
            self._log.close(keep=False)
            self._log = self._begin()

    def motion(self, trajectory: JointTrajectory) -> int:
        """Record a motion that a law begins to follow; returns its identifier for the note."""
        data = bytes(serialize_message(trajectory_to_message(trajectory)))
        self._add(topics.MOTION_TRAJECTORY, data, self._now)
        return zlib.crc32(data)

    def event(self, text: str) -> None:
        """Record an event."""
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
        """Record a tick: true state, input and output of the estimator, result of the law, and its inputs ``note``."""
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
            self._add(topics.JOINT_SETPOINTS, self._command.encode(now, result.command), now)
        if note:
            self._say(topics.APPLIED, note, now)
        if plant.t >= self._next_odometry:
            self._next_odometry = plant.t + ODOMETRY_PERIOD
            self._add(topics.ODOM, self._odometry.encode(now, state), now)
            self._add(topics.GROUND_TRUTH, self._odometry.encode(now, plant.truth), now)

    def close(self) -> dict[str, int]:
        """Complete the file and move it to its path; returns message counts by topic. Later calls write nothing."""
        if self._log is None:
            return {}
        log, self._log = self._log, None
        log.close()
        return log.counts

    def discard(self) -> None:
        """Delete the incomplete file."""
        if self._log is not None:
            self._log.close(keep=False)
            self._log = None
