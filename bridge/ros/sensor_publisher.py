"""The sensors of one tick as topics; the joints come last and complete the tick."""

from __future__ import annotations

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Imu, JointState

from bridge.fault_channels import FEET, IMU, JOINT_STATES
from bridge.mujoco_plant import MujocoPlant
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import ImuCodec, JointStateCodec, WrenchCodec
from models.nodes.qos import sensor
from models.robot_model import SOLE_FRAMES
from models.types import SensorData


class SensorPublisher:
    """Publishes ``SensorData``.

    Args:
        node: Node that publishes.
        plant: Whose sensors they are.
        reliable: Whether no sample may be lost (lockstep).
    """

    def __init__(self, node: PoiseNode, plant: MujocoPlant, *, reliable: bool) -> None:
        self._plant = plant
        qos = sensor(reliable=reliable)
        self._imu_codec, self._joint_codec = ImuCodec(topics.IMU_FRAME), JointStateCodec(node.model)
        feet = topics.foot_wrenches(node.model)
        self._foot_codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._imu = node.announce(Imu, topics.IMU_RAW, qos)
        self._feet = [node.announce(WrenchStamped, topic, qos) for topic in feet]
        self._joints = node.announce(JointState, topics.JOINT_STATES, qos)

    def publish(self, stamp: int, sensors: SensorData) -> None:
        """Publish one sample of everything with the same stamp [ns], as far as no fault of the plant keeps it back."""
        heard = self._plant.heard(sensors) or sensors
        silent = self._plant.faults.silent
        stamp = max(stamp + round((heard.t - sensors.t) * NANOSECONDS), 0)
        if IMU not in silent:
            self._imu.publish(self._imu_codec.encode(stamp, heard.gyro, heard.accel))
        for foot, publisher in enumerate(self._feet):
            if FEET[foot] not in silent:
                publisher.publish(self._foot_codecs[foot].encode(stamp, heard.wrenches[foot]))
        if JOINT_STATES not in silent:
            self._joints.publish(self._joint_codec.encode(stamp, heard.q, heard.v, heard.tau))
