"""A simulated robot behind ros2_control; broadcasters and controllers follow the documentation of ros2_control.

In each cycle of the controller manager the joint states, IMU and foot wrenches are published with one stamp, joints in
alphabetical order. The command controller keeps its last command without a timeout. A command of a wrong size makes its
update fail; the controller manager then deactivates it, and the torques are zero.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

from bridge.plants.gantry import STEP, HangingRobot, StepLink
from bridge.plants.ros2_control.commands import PVT
from bridge.plants.ros2_control.config import (
    COMMAND,
    FEET,
    IMU,
    JOINTS,
    Ros2ControlConfig,
    Source,
    read_config,
    sources,
)
from bridge.plants.ros2_control.link import Message
from models.nodes.cdr import NANOSECONDS, Template
from models.nodes.interfaces import interface
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import JointCommand, SensorData, Vector

EPOCH_S = 1_700_000_000  #: Stamp of tick 0 [s]


class ControlledRobot(HangingRobot):
    """Broadcasters and one command controller around ``HangingRobot``.

    Args:
        robot: Profile of the simulated robot.
        laws: Profile of the plant; its sensors are published.
        settings: Options of the plant.
        options: Options of ``HangingRobot``.
    """

    def __init__(
        self, robot: str = "g1", *, laws: str = "", settings: Mapping[str, Any] | None = None, **options: Any
    ) -> None:
        self.settings: Ros2ControlConfig = read_config(settings or {})
        super().__init__(robot, rate=self.settings.rate, **options)
        self.sources = sources(RobotModel.load(laws or robot))
        self.broken = frozenset[str]()  #: Sources that are not published
        self.stamp_offset = 0  #: Jump of the stamps [ns]
        names = [self.settings.controllers[source] for source in (*self.sources, COMMAND)]
        self.controllers = dict.fromkeys(names, "active")  #: State by name
        self.moving_joints: Sequence[str] = self.model.joint_names  #: Joints of linear_feedback_controller in its order
        self._controller = make_controller(self.settings, self.model)
        self._order = np.argsort(self.model.joint_names)
        joints = JointState(name=[self.model.joint_names[i] for i in self._order])
        joints.header.frame_id = "base_link"
        for field in ("position", "velocity", "effort"):
            setattr(joints, field, [0.0] * self.model.nj)
        self._joints = Template(joints, ("position", "velocity", "effort"))
        imu, wrench = Imu(), [WrenchStamped() for _ in FEET]
        imu.header.frame_id = "imu"
        for message, frame in zip(wrench, SOLE_FRAMES, strict=True):
            message.header.frame_id = frame
        self._imu = Template(imu, ("orientation", "angular_velocity", "linear_acceleration"))
        self._wrenches = [Template(message, ("wrench",)) for message in wrench]

    @property
    def stamp(self) -> int:
        """Stamp of this cycle [ns]."""
        return EPOCH_S * NANOSECONDS + round(self.tick * STEP * NANOSECONDS) + self.stamp_offset

    def states(self) -> list[Message]:
        """Messages of this cycle, by source."""
        sensors, stamp = self.read(), self.stamp
        joints = [values[self._order] for values in (sensors.q, sensors.v, sensors.tau)]
        quaternion = np.roll(self.imu_quaternion, -1)
        found = {
            JOINTS: lambda: self._joints.pack(stamp, joints),
            IMU: lambda: self._imu.pack(stamp, [quaternion, sensors.gyro, sensors.accel]),
        }
        for foot, source in enumerate(FEET):
            found[source] = partial(self._wrenches[foot].pack, stamp, [sensors.wrenches[foot]])
        return [(source, found[source]()) for source in self.sources if source not in self.broken]

    def receive(self, data: bytes) -> None:
        """Handle a command; one of a wrong size deactivates the controller."""
        if self.controllers[self.settings.controllers[COMMAND]] != "active":
            return
        if self._controller.accept(data):
            self.received += 1
            return
        self.refused += 1
        self.deactivate(COMMAND)

    def deactivate(self, source: Source) -> None:
        """Deactivate the controller of a source; the command controller drops its last command."""
        self.controllers[self.settings.controllers[source]] = "inactive"
        if source == COMMAND:
            self._controller.reset()

    def drive(self) -> JointCommand:
        command: JointCommand = self._controller.command(self.plant.read())
        return command


class EffortController:
    """JointGroupEffortController: torques in the order of its parameter ``joints``."""

    def __init__(self, model: RobotModel) -> None:
        self._nj = model.nj
        self.reset()

    def reset(self) -> None:
        """Set zero torque."""
        self._torque = np.zeros(self._nj)

    def accept(self, data: bytes) -> bool:
        """Accept a message; returns whether its size is right. Non-finite messages are dropped."""
        values = np.array(deserialize_message(data, Float64MultiArray).data)
        if np.isfinite(values).all():
            if len(values) != self._nj:
                return False
            self._torque = values
        return True

    def command(self, sensors: SensorData) -> JointCommand:
        """Command of the drives."""
        return JointCommand.torque(self._torque)


class PvtController:
    """GpioCommandController with the interfaces ``PVT`` of each joint, and drives with a PD law."""

    def __init__(self, model: RobotModel) -> None:
        self._kind, self._names = interface("control_msgs", "msg", "DynamicInterfaceGroupValues"), model.joint_names
        self.reset()

    def reset(self) -> None:
        """Set zero torque and gains."""
        self._rows = np.zeros((len(PVT), len(self._names)))

    def accept(self, data: bytes) -> bool:
        """Accept a message; returns whether names and values of each group match. Unknown interfaces are ignored."""
        message = deserialize_message(data, self._kind)
        for name, group in zip(message.interface_groups, message.interface_values, strict=True):
            if len(group.interface_names) != len(group.values):
                return False
            for each, value in zip(group.interface_names, group.values, strict=True):
                if name in self._names and each in PVT:
                    self._rows[PVT.index(each), self._names.index(name)] = value
        return True

    def command(self, sensors: SensorData) -> JointCommand:
        """Command of the drives."""
        return JointCommand(*self._rows.copy())


class FeedbackController:
    """LinearFeedbackController: tau = feedforward + K (x_d - x), damping with ``d`` before the first message.

    Without ``free_flyer`` x is (q, v) (2 nj,); the base is not part of it.
    """

    def __init__(self, model: RobotModel, free_flyer: bool) -> None:
        self._kind, self._model = interface("linear_feedback_controller_msgs", "msg", "Control"), model
        self._base = 6 if free_flyer else 0
        self.reset()

    def reset(self) -> None:
        """Reset to the state before the first message."""
        self._law: tuple[Vector, ...] | None = None

    def accept(self, data: bytes) -> bool:
        """Accept a message; returns whether the layout of its matrices is right."""
        message = deserialize_message(data, self._kind)
        nj, columns = self._model.nj, 2 * (self._model.nj + self._base)
        sizes = [[(d.size, d.stride) for d in each.layout.dim] for each in (message.feedback_gain, message.feedforward)]
        if sizes != [[(nj, nj * columns), (columns, columns)], [(nj, nj), (1, 1)]]:
            return False
        gain = np.array(message.feedback_gain.data).reshape(nj, columns)
        joints = message.initial_state.joint_state
        self._law = gain, np.array(message.feedforward.data), np.array(joints.position), np.array(joints.velocity)
        return True

    def command(self, sensors: SensorData) -> JointCommand:
        """Command of the drives: a torque, or damping before the first message."""
        if self._law is None:
            zero = np.zeros(self._model.nj)
            return JointCommand(zero, zero, zero, zero, self._model.kd)
        gain, feedforward, q, v = self._law
        base = np.zeros(self._base)
        return JointCommand.torque(feedforward + gain @ np.concatenate([base, q - sensors.q, base, v - sensors.v]))


def make_controller(config: Ros2ControlConfig, model: RobotModel) -> Any:
    """Create the command controller of a configuration."""
    if config.command == "effort":
        return EffortController(model)
    return PvtController(model) if config.command == "pvt" else FeedbackController(model, config.free_flyer)


class DirectControlLink(StepLink):
    """``ControlLink`` to a robot in the same process."""

    robot: ControlledRobot

    def controllers(self) -> Mapping[str, str] | None:
        """State of each controller by name; None without a connection."""
        return self.robot.controllers if self.connected else None

    def joint_order(self) -> Sequence[str] | None:
        """Joints of linear_feedback_controller."""
        return self.robot.moving_joints
