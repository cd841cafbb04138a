"""Topics of the driver: commands and mode in; sensors, state, time and the truth out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState, LaserScan
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from bridge.driver.drivers import Drivers
from bridge.driver.probes import LatencyProbe
from bridge.plants.base import SimulatedPlant
from bridge.plants.fault_effects import FEET, IMU, JOINT_STATES
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.scanner import LaserScanner
from controllers.joints.motor_driver import check_stamp
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import (
    ImuCodec,
    JointCommandCodec,
    JointStateCodec,
    WrenchCodec,
    mode_named,
    set_stamp,
    to_seconds,
)
from models.nodes.odometry import OdometryCodec
from models.nodes.perception import scan_to_message
from models.nodes.qos import COMMAND, LATCHED, SENSOR, sensor
from models.robot_model import SOLE_FRAMES
from models.types import SensorData


class CommandInput:
    """Accepts commands computed from recent sensors; refuses the rest by name.

    A command is refused when its sensors are older than ``max_age`` [ns]; ``period`` is the tick [ns]. ``probe``
    records arrivals, optional; ``on_mode_change`` is called when a mode may have changed the state of the drivers.
    ``now`` is the stamp of the present tick [ns], set by the node, ``stamp`` that of the command in force [ns].
    """

    def __init__(
        self,
        node: PoiseNode,
        drivers: Drivers,
        period: int,
        max_age: int,
        probe: LatencyProbe | None,
        on_mode_change: Callable[[], None],
    ) -> None:
        self._node, self._drivers, self._probe, self._on_mode_change = node, drivers, probe, on_mode_change
        self._period, self._max_age = period, max_age
        self._codec = JointCommandCodec(node.model)
        self.now = period
        self.stamp = 0  # a zero stamp means "now" in a command
        node.listen(JointTrajectory, topics.JOINT_COMMAND, self.on_command, COMMAND, raw=True)
        node.listen(String, topics.MODE, self.on_mode, LATCHED)

    def on_command(self, data: bytes) -> None:
        """Pass a command to the drivers, or refuse it."""
        if not self._node.active:
            return
        if self._probe is not None:
            self._probe.arrive()
        try:
            stamp, command = self._codec.decode(data)
            check_stamp(stamp, self.stamp, self.now, self._max_age, self._node.counters)
            if self._drivers.command(command):
                self.stamp = stamp or self.stamp
                if stamp and self._probe is not None:
                    self._probe.receive(stamp // self._period)
        except PoiseError as error:
            self._node.refuse(topics.JOINT_COMMAND, error)

    def on_mode(self, message: String) -> None:
        """Apply the supervisor's mode."""
        if not self._node.active:
            return
        try:
            self._drivers.set_mode(mode_named(message.data))
        except PoiseError as error:
            self._node.refuse(topics.MODE, error)
        self._on_mode_change()


class SensorTopics:
    """Publishes ``SensorData``, reliably in lockstep; the joints come last and complete the tick.

    ``simulated`` is a simulated plant, whose faults suppress messages; None for any other plant.
    """

    def __init__(self, node: PoiseNode, simulated: SimulatedPlant | None, *, reliable: bool) -> None:
        self._plant = simulated
        qos = sensor(reliable=reliable)
        self._imu_codec, self._joint_codec = ImuCodec(topics.IMU_FRAME), JointStateCodec(node.model)
        feet = topics.foot_wrenches(node.model)
        self._foot_codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._imu = node.announce(Imu, topics.IMU_RAW, qos)
        self._feet = [node.announce(WrenchStamped, topic, qos) for topic in feet]
        self._joints = node.announce(JointState, topics.JOINT_STATES, qos)

    def publish(self, stamp: int, sensors: SensorData) -> None:
        """Publish a sample with one stamp [ns], except messages that a fault suppresses."""
        missing: frozenset[str] = frozenset()
        if self._plant is not None:
            delivered = self._plant.transmit(sensors) or sensors
            missing = self._plant.faults.missing
            stamp = max(stamp + round((delivered.t - sensors.t) * NANOSECONDS), 0)
            sensors = delivered
        if IMU not in missing:
            self._imu.publish(self._imu_codec.encode(stamp, sensors.gyro, sensors.accel))
        for foot, publisher in enumerate(self._feet):
            if FEET[foot] not in missing:
                publisher.publish(self._foot_codecs[foot].encode(stamp, sensors.wrenches[foot]))
        if JOINT_STATES not in missing:
            self._joints.publish(self._joint_codec.encode(stamp, sensors.q, sensors.v, sensors.tau))


class ScanTopic:
    """Publishes ``scan`` at the scanner's rate while it has a subscriber; nothing for a robot without scanner.

    ``noise`` is a factor on the scanner's noise of ``seed``; ``reliable`` is set in lockstep.
    """

    def __init__(self, node: PoiseNode, plant: MujocoPlant, *, seed: int, noise: float, reliable: bool) -> None:
        self._plant = plant
        self._last = self._ticks = 0
        if plant.robot.profile.sensors.scan is None:
            return
        self._scanner = LaserScanner(plant, seed, noise)
        self._period = 1.0 / self._scanner.config.rate
        self._ticks = max(round(self._period / plant.period), 1)
        self._publisher = node.announce(LaserScan, topics.SCAN, sensor(reliable=reliable))

    def publish(self, tick: int, stamp: int) -> None:
        """Publish the scan of a tick with a stamp [ns], once, where due."""
        if not self._ticks or tick % self._ticks or stamp == self._last or not self._publisher.get_subscription_count():
            return
        self._last = stamp
        scan = self._plant.transmit_scan(self._scanner.scan(to_seconds(stamp)))
        if scan is not None:
            self._publisher.publish(scan_to_message(stamp, scan, self._period))


class StatusTopics:
    """Publishers of ``/clock``, ``driver_state``, ``encoder_offsets`` and ``robot_description``."""

    def __init__(self, node: PoiseNode, drivers: Drivers) -> None:
        self._drivers, self._published = drivers, ""
        self._codec = JointStateCodec(node.model)
        self._zero = np.zeros(node.model.nj)
        self._time = node.announce(Clock, topics.CLOCK, SENSOR)
        self._state = node.announce(String, topics.DRIVER_STATE, LATCHED)
        self._offsets = node.announce(JointState, topics.ENCODER_OFFSETS, LATCHED)
        self._description = node.announce(String, topics.ROBOT_DESCRIPTION, LATCHED)

    def publish_latched(self, description: str, stamp: int) -> None:
        """Publish description, encoder offsets and state with a stamp [ns], once the node is active."""
        self._description.publish(String(data=description))
        self.publish_start(stamp)

    def publish_start(self, stamp: int) -> None:
        """Publish the encoder offsets, and the state even if it is unchanged: ``held`` twice is a reset; stamp [ns]."""
        offsets = self._drivers.encoder_offsets
        offsets = self._zero if offsets is None else offsets
        self._offsets.publish(self._codec.encode(stamp, offsets, self._zero, self._zero))
        self._published = ""
        self.publish_state()

    def publish_time(self, stamp: int) -> None:
        """Publish the time of the robot [ns]."""
        message = Clock()
        set_stamp(message.clock, stamp)
        self._time.publish(message)

    def publish_state(self) -> None:
        """Publish the state of the drivers, if it has changed."""
        if self._published != self._drivers.state:
            self._published = self._drivers.state
            self._state.publish(String(data=self._published))


class TruthTopics:
    """Publishers of ``ground_truth/odom``, and of ``joint_states`` and ``obstacle`` beside it while subscribed to."""

    def __init__(self, node: PoiseNode, plant: SimulatedPlant) -> None:
        self._plant = plant
        self._codec, self._joint_codec = OdometryCodec(), JointStateCodec(node.model)
        self._odometry = node.announce(Odometry, topics.GROUND_TRUTH, SENSOR)
        self._joints = node.announce(JointState, topics.GROUND_TRUTH_JOINTS, SENSOR)
        self._obstacle = node.announce(PoseStamped, topics.GROUND_TRUTH_OBSTACLE, SENSOR)

    def publish(self, stamp: int) -> None:
        """Publish the true state and the place of the obstacle with a stamp [ns]; the joints last."""
        truth = self._plant.truth
        self._odometry.publish(self._codec.encode(stamp, truth))
        centre = self._plant.obstacle_centre
        if centre is not None and self._obstacle.get_subscription_count():
            message = PoseStamped()
            set_stamp(message.header.stamp, stamp)
            message.header.frame_id = topics.ODOM_FRAME
            place = message.pose.position
            place.x, place.y, place.z = centre.tolist()
            self._obstacle.publish(message)
        if self._joints.get_subscription_count():
            self._joints.publish(self._joint_codec.encode(stamp, truth.q[7:], truth.v[6:], truth.tau))
