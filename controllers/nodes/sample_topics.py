"""The sensors' topics as one ``SensorData`` for each tick."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import Imu, JointState

from controllers.sample_assembler import MAX_AGE, SampleAssembler
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.messages import ImuCodec, JointStateCodec, WrenchCodec
from models.nodes.parameters import describe
from models.nodes.qos import sensor
from models.robot_model import SOLE_FRAMES
from models.types import SensorData


def declare_ages(node: PoiseNode) -> tuple[int, int]:
    """Declare the parameters of ``SampleAssembler``; returns ``max_age_ns`` and ``max_gap_ns`` [ns]."""
    age = describe("Oldest inertial or foot sample used with newer joints [s]", low=0.0, high=1.0)
    gap = describe("Largest step of a stamp believed at once [s]", low=0.0, high=10.0)
    seconds = node.declare_parameter("max_age", MAX_AGE, age).value, node.declare_parameter("max_gap", 0.05, gap).value
    return round(NANOSECONDS * float(seconds[0])), round(NANOSECONDS * float(seconds[1]))


class SampleTopics:
    """Subscribes to joints, inertial unit and feet; what is refused is counted by the node.

    Args:
        node: Node that subscribes.
        ages: From ``declare_ages``.
        take: Called with every tick's data and its stamp [ns]; may raise ``PoiseError`` to refuse it.
        again: Called instead, in lockstep, when the plant repeats the joints of this stamp [ns]: an answer was lost.
        lockstep: Whether the plant waits for an answer to each tick.

    Attributes:
        assembler: Joins the samples.
    """

    def __init__(
        self,
        node: PoiseNode,
        ages: tuple[int, int],
        take: Callable[[SensorData, int], None],
        again: Callable[[], None],
        *,
        lockstep: bool,
    ) -> None:
        self._node, self._take, self._again, self._lockstep = node, take, again, lockstep
        self.assembler = SampleAssembler(*ages, strict=lockstep, feet=node.model.profile.sensors.feet.fitted)
        self._taken: int | None = None
        self._joint_codec, self._imu_codec = JointStateCodec(node.model), ImuCodec(topics.IMU_FRAME)
        qos = sensor(reliable=lockstep)
        node.listen(Imu, topics.IMU_RAW, self._on_imu, qos, raw=True)
        for foot, topic in enumerate(topics.foot_wrenches(node.model)):
            node.listen(WrenchStamped, topic, self._foot_callback(foot), qos, raw=True)
        node.listen(JointState, topics.JOINT_STATES, self.on_joints, qos, raw=True)

    def reset(self) -> None:
        """Forget every sample."""
        self._taken = None
        self.assembler.reset()

    def _on_imu(self, data: bytes) -> None:
        self._add(topics.IMU_RAW, lambda: self.assembler.add_imu(*self._imu_codec.decode(data)))

    def on_joints(self, data: bytes) -> None:
        """Take serialised joint states."""
        self._add(topics.JOINT_STATES, lambda: self._add_joints(data))

    def _add_joints(self, data: bytes) -> SensorData | None:
        if self._lockstep and stamp_of(data) == self._taken:
            self._again()
            return None
        return self.assembler.add_joints(*self._joint_codec.decode(data))

    def _foot_callback(self, foot: int) -> Callable[[bytes], None]:
        codec, topic = WrenchCodec(SOLE_FRAMES[foot]), topics.FOOT_WRENCHES[foot]

        def on_foot(data: bytes) -> None:
            self._add(topic, lambda: self.assembler.add_foot(foot, *codec.decode(data)))

        return on_foot

    def _add(self, topic: str, add: Callable[[], SensorData | None]) -> None:
        """Take one sample; a complete tick is passed on."""
        if not self._node.active:
            return
        try:
            sensors = add()
            if sensors is not None:
                stamp = self.assembler.stamp or 0
                self._take(sensors, stamp)
                self._taken = stamp
        except PoiseError as error:
            self._node.refuse(topic, error)
