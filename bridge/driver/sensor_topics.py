"""The sensors of a tick as topics: joints, IMU, feet, and the scanner of a simulated robot."""

from __future__ import annotations

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Imu, JointState, LaserScan

from bridge.plants.base import SimulatedPlant
from bridge.plants.fault_effects import FEET, IMU, JOINT_STATES
from bridge.plants.mujoco import MujocoPlant
from bridge.plants.scanner import LaserScanner
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import ImuCodec, JointStateCodec, WrenchCodec, to_seconds
from models.nodes.perception import scan_to_message
from models.nodes.qos import sensor
from models.robot_model import SOLE_FRAMES
from models.types import SensorData


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
