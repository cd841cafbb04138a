"""Node ``state_estimator``: joint states, inertial unit and foot wrenches in, ``/odom`` and ``/contacts`` out."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import String, UInt8MultiArray

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.estimator import StateEstimator
from controllers.nodes.calibration_services import CalibrationServices
from controllers.sample_assembler import SampleAssembler, mean_sample
from models.config import default_config
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.messages import ImuCodec, JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec, contacts_to_message
from models.nodes.parameters import declare_config, describe
from models.nodes.qos import LATCHED, sensor
from models.nodes.spin import run
from models.robot_model import SOLE_FRAMES
from models.types import RobotState, SensorData


class StateEstimatorNode(PoiseNode):
    """Runs ``StateEstimator`` once for each complete set of samples.

    Args:
        hand_over: Called with every state and its stamp [ns] when the controller lives in this process; ``/odom`` is
            then published at ``odom_rate`` only.
        kwargs: Passed to rclpy.
    """

    def __init__(self, hand_over: Callable[[RobotState, int], None] | None = None, **kwargs: Any) -> None:
        super().__init__("state_estimator", **kwargs)
        self._hand_over = hand_over
        self._config = declare_config(self, default_config(EstimatorConfig, "controllers", "estimator"))
        self._lockstep = topics.declare_lockstep(self)
        rate = describe("Rate of /odom and /contacts when the controller shares the process [Hz]", low=1.0, high=1000.0)
        odom_rate = 100.0 if hand_over is not None else 1000.0
        self._odom_period = round(NANOSECONDS / float(self.declare_parameter("odom_rate", odom_rate, rate).value))
        age = describe("Oldest inertial or foot sample used with newer joints [s]", low=0.0, high=1.0)
        self._max_age = round(NANOSECONDS * float(self.declare_parameter("max_age", 0.005, age).value))
        gap = describe("Largest step of a stamp believed at once [s]", low=0.0, high=10.0)
        self._max_gap = round(NANOSECONDS * float(self.declare_parameter("max_gap", 0.05, gap).value))
        count = describe("Samples averaged for the start, at rest (lockstep: 1)", integer=(1, 10000))
        self._start_samples = 1 if self._lockstep else int(self.declare_parameter("start_samples", 100, count).value)
        self._started = False
        self._first: list[SensorData] = []
        self._state: RobotState | None = None
        self._last_stamp = self._last_odom = 0
        self._driver_state = ""

    def configure(self) -> None:
        """Build the law, the codecs and the topics."""
        self._law = StateEstimator(self.model, self._config)
        self._assembler = SampleAssembler(self._max_age, self._max_gap, strict=self._lockstep)
        self._joint_codec, self._imu_codec = JointStateCodec(self.model), ImuCodec(topics.IMU_FRAME)
        self._foot_codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._odom_codec = OdometryCodec()
        qos = sensor(reliable=self._lockstep)
        self._odom = self.announce(Odometry, topics.ODOM, qos)
        self._contacts = self.announce(UInt8MultiArray, topics.CONTACTS, qos)
        self.listen(Imu, topics.IMU, self._on_imu, qos, raw=True)
        for foot, topic in enumerate(topics.FOOT_WRENCHES):
            self.listen(WrenchStamped, topic, self._foot_callback(foot), qos, raw=True)
        self.listen(JointState, topics.JOINT_STATES, self._on_joints, qos, raw=True)
        self.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        self._calibration = CalibrationServices(self, self.activate)

    def activate(self) -> None:
        """Start from the next complete sample, with the newest calibration."""
        self._calibration.start()
        self._started = False
        self._first.clear()
        self._state = None
        self._assembler.reset()

    def before_diagnostics(self) -> None:
        """Report what the estimator met."""
        if not self.active:
            return
        self.message = "estimating" if self._started else "waiting for a complete sample"
        health = self._law.health
        self.values["samples with mixed stamps"] = str(self._assembler.incomplete)
        self.values["ticks without a usable sample"] = str(self._assembler.dropped)
        self.values["stale"], self.values["gated"] = str(health.stale), str(health.gated)

    def _on_imu(self, data: bytes) -> None:
        self._take(topics.IMU, lambda: self._assembler.add_imu(*self._imu_codec.decode(data)))

    def _on_joints(self, data: bytes) -> None:
        self._take(topics.JOINT_STATES, lambda: self._add_joints(data))

    def _add_joints(self, data: bytes) -> SensorData | None:
        if self._lockstep and self._state is not None and stamp_of(data) == self._last_stamp:
            self._give(self._state, self._last_stamp)  # the plant asks again: an answer was lost
            return None
        return self._assembler.add_joints(*self._joint_codec.decode(data))

    def _foot_callback(self, foot: int) -> Callable[[bytes], None]:
        codec, topic = self._foot_codecs[foot], topics.FOOT_WRENCHES[foot]

        def on_foot(data: bytes) -> None:
            self._take(topic, lambda: self._assembler.add_foot(foot, *codec.decode(data)))

        return on_foot

    def _take(self, topic: str, add: Callable[[], SensorData | None]) -> None:
        """Take one sample; a complete tick runs the law."""
        if not self.active:
            return
        try:
            sensors = add()
            if sensors is not None:
                self._step(sensors)
        except PoiseError as error:
            self.refuse(topic, error)

    def _step(self, sensors: SensorData) -> None:
        stamp = self._assembler.stamp or 0
        sensors = self._calibration.correct(sensors)
        if self._started:
            state = self._law.step(sensors, (stamp - self._last_stamp) / NANOSECONDS)
        else:
            self._first.append(sensors)
            if len(self._first) < self._start_samples:
                return
            state = self._law.reset(mean_sample(self._first))
            self._first.clear()
            self._started = True
        self._last_stamp = stamp
        self._give(state, stamp)

    def _give(self, state: RobotState, stamp: int) -> None:
        """Hand the state to the controller at once, or publish it."""
        self._state = state
        if self._hand_over is not None:
            self._hand_over(state, stamp)
            if not self._lockstep and 0 <= stamp - self._last_odom < self._odom_period:
                return
        self._last_odom = stamp
        self._contacts.publish(contacts_to_message(state.contacts))
        self._odom.publish(self._odom_codec.encode(stamp, state))

    def _on_driver_state(self, message: String) -> None:
        """Start over when the robot has been put back to its start."""
        if message.data == topics.HELD and self._driver_state != topics.HELD and self._started:
            self.activate()
        self._driver_state = message.data


def main(args: list[str] | None = None) -> None:
    """Run the node in a process of its own."""
    sys.exit(run([StateEstimatorNode], args))


if __name__ == "__main__":
    main()
