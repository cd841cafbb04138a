"""Encodes joint commands as messages of ros2_control's command controllers.

- ``effort``: effort_controllers/JointGroupEffortController, or forward_command_controller/ForwardCommandController with
  interface ``effort``. The PD law of the drives is evaluated here, at the newest state.
- ``pvt``: gpio_controllers/GpioCommandController, which sets all command interfaces of a message at once, with the
  interfaces ``PVT`` of each joint. The drives evaluate the PD law.
- ``feedback``: linear_feedback_controller, tau = feedforward + K (x_d - x); K has only joint gains here.

Joints are in the order of the robot's profile, which is the order of Pinocchio. Each command has a mark of its sender.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from msgspec.structs import replace
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from bridge.plants.hardware import session
from bridge.plants.ros2_control.config import Ros2ControlConfig
from controllers.joints.joint_servo import drive_torque
from models.errors import ConfigError, MessageError
from models.nodes.cdr import STAMP_OFFSET, STAMP_SIZE, Template
from models.nodes.interfaces import interface
from models.nodes.messages import decode
from models.robot_model import RobotModel
from models.types import JointCommand, Vector

#: Prefix of a driver's mark, followed by its session; mark of the guard of this process's graph
DRIVER, GUARD = "poise_driver", f"poise_guard_{session():08x}"
#: Stable gains: bound of kd relative to rotor inertia / longest delay, and of kp relative to kd / longest delay [-]
DAMPING_SHARE, STIFFNESS_SHARE = 1.2, 0.4
#: Command interfaces of a joint with drive-side PD, named as in ``hardware_interface`` of ros2_control
PVT = ("position", "velocity", "effort", "proportional", "derivative")
_FRAME_ID = STAMP_OFFSET + STAMP_SIZE  #: Offset of ``header.frame_id`` [bytes]
_DIMENSIONS, _LABEL = 4, 8  #: Offsets of a layout's number of dimensions and of the first label [bytes]


def driver_mark() -> str:
    """Mark of the driver of this process's graph."""
    return f"{DRIVER}_{session():08x}"


class CommandCodec(Protocol):
    """Messages of one command controller.

    ``evaluated`` is whether a message depends on the state; then it must not be repeated without a new state.
    """

    kind: Any
    evaluated: bool

    def executed(self, command: JointCommand) -> JointCommand:
        """The command as the controller executes it."""
        return command

    def encode(self, stamp: int, command: JointCommand, q: Vector, v: Vector, last: bytes = b"") -> bytes:
        """Serialised message of a command for the state q [rad], v [rad/s] (nj,) measured at a stamp [ns].

        ``last`` is the previous message with any mark; empty for none.
        """

    def decode(self, data: bytes) -> JointCommand:
        """Command in a message of ``encode`` with any mark; ``MessageError`` for a wrong size."""

    def mark(self, data: bytes) -> str:
        """Mark of the sender in a serialised message, by default its frame id; empty without one."""
        return _text(data, _FRAME_ID)


class EffortCodec(CommandCodec):
    """std_msgs/Float64MultiArray: torques (nj,) [N.m] within the limits of the profile. The mark is a label.

    The change of a torque per ``period`` [s] is within the drives' rate limit, as in a drive that evaluates the PD law.
    This bounds the steps of the damping torque of a shaken joint.

    The PD loop includes the network. For a rotor of inertia I, the gains kd = a I / T and kp = b kd / T, and a delay t
    from a state to its torque, the open loop is a (s T + b) exp(-s t) / (s T)^2. With a = 1.2, b = 0.4 the phase at the
    crossover s T = 1.26 i is -180 deg for t = 1.003 T. The loop is thus stable up to the delay T = ``delay_max`` [s],
    with a phase margin of 36 deg at half of it. The links add to the inertia: M = diag(I) + L with L >= 0. Raises
    ``ConfigError`` for a joint without rotor inertia.
    """

    kind = Float64MultiArray
    evaluated = True

    def __init__(self, model: RobotModel, mark: str, delay_max: float, period: float) -> None:
        for name, inertia in zip(model.joint_names, model.armature, strict=True):
            if inertia <= 0.0:
                raise ConfigError(
                    f"robot '{model.name}': joint '{name}' has armature 0, so no gain of command effort is stable: "
                    f"give its rotor inertia in the profile, or use command pvt or feedback"
                )
        self._model, self._step = model, period * model.tau_rate_max
        self._kd_max, self._kp_of_kd = DAMPING_SHARE * model.armature / delay_max, STIFFNESS_SHARE / delay_max
        message = Float64MultiArray(data=[0.0] * model.nj)
        message.layout.dim = [MultiArrayDimension(label=mark, size=model.nj, stride=model.nj)]
        self._begin = bytes(serialize_message(message))[: -8 * model.nj]  # before the numbers

    def executed(self, command: JointCommand) -> JointCommand:
        kp, kd = _gains(command, (self._model.kp, self._model.kd))
        kd = np.minimum(kd, self._kd_max)
        return replace(command, kp=np.minimum(kp, self._kp_of_kd * kd), kd=kd)

    def encode(self, stamp: int, command: JointCommand, q: Vector, v: Vector, last: bytes = b"") -> bytes:
        limit = self._model.tau_max
        torque = np.clip(drive_torque(self._model, self.executed(command), q, v), -limit, limit)
        if last:
            before = np.frombuffer(last[-8 * self._model.nj :])
            torque = np.clip(torque, before - self._step, before + self._step)
        return self._begin + torque.astype("<f8").tobytes()

    def decode(self, data: bytes) -> JointCommand:
        return JointCommand.torque(_numbers("data", decode(data, self.kind).data, self._model.nj))

    def mark(self, data: bytes) -> str:
        return _text(data, _LABEL) if data[_DIMENSIONS:_LABEL] != bytes(4) else ""


class PvtCodec(CommandCodec):
    """control_msgs/DynamicInterfaceGroupValues: the interfaces ``PVT`` of each joint. The mark is the frame id."""

    evaluated = False

    def __init__(self, model: RobotModel, mark: str) -> None:
        self.kind = interface("control_msgs", "msg", "DynamicInterfaceGroupValues")
        value = interface("control_msgs", "msg", "InterfaceValue")
        message = self.kind(interface_groups=list(model.joint_names))
        message.header.frame_id = mark
        message.interface_values = [
            value(interface_names=list(PVT), values=[0.0] * len(PVT)) for _ in model.joint_names
        ]
        self._template = Template(message, [f"interface_values.{i}.values" for i in range(model.nj)])
        self._rows = np.zeros((model.nj, len(PVT)))
        self._gains = model.kp, model.kd

    def encode(self, stamp: int, command: JointCommand, q: Vector, v: Vector, last: bytes = b"") -> bytes:
        kp, kd = _gains(command, self._gains)
        for column, values in enumerate((command.q, command.v, command.tau, kp, kd)):
            self._rows[:, column] = values
        return self._template.pack(stamp, list(self._rows))

    def decode(self, data: bytes) -> JointCommand:
        values = [value for group in decode(data, self.kind).interface_values for value in group.values]
        return JointCommand(*_numbers("interface_values", values, self._rows.size).reshape(self._rows.shape).T)


class FeedbackCodec(CommandCodec):
    """linear_feedback_controller_msgs/Control: K = [0 kp 0 kd] (nj, 2 nv), feed-forward torque and desired state.

    With ``free_flyer`` nv includes the base: its columns are zero, its desired pose is the origin. Otherwise nv = nj.
    The mark is the frame id.
    """

    evaluated = False

    def __init__(self, model: RobotModel, mark: str, *, free_flyer: bool) -> None:
        self.kind = interface("linear_feedback_controller_msgs", "msg", "Control")
        nj, nv = model.nj, model.nj + (6 if free_flyer else 0)
        message, joints = self.kind(), list(model.joint_names)
        message.header.frame_id = mark
        for field, columns in ((message.feedback_gain, 2 * nv), (message.feedforward, 1)):
            field.data = [0.0] * (nj * columns)
            field.layout.dim = [
                MultiArrayDimension(label="rows", size=nj, stride=nj * columns),
                MultiArrayDimension(label="cols", size=columns, stride=columns),
            ]
        state = message.initial_state
        state.base_pose.orientation.w = 1.0
        state.joint_state.name = joints
        state.joint_state.position, state.joint_state.velocity = [0.0] * nj, [0.0] * nj
        state.joint_state.effort = [0.0] * nj
        fields = ("feedback_gain.data", "feedforward.data", "initial_state.joint_state.position")
        self._template = Template(message, (*fields, "initial_state.joint_state.velocity"))
        self._gains = model.kp, model.kd
        self._matrix = np.zeros((nj, 2 * nv))
        rows = np.arange(nj)
        self._stiffness, self._damping = (rows, rows + nv - nj), (rows, rows + 2 * nv - nj)

    def encode(self, stamp: int, command: JointCommand, q: Vector, v: Vector, last: bytes = b"") -> bytes:
        self._matrix[self._stiffness], self._matrix[self._damping] = _gains(command, self._gains)
        return self._template.pack(stamp, [self._matrix.ravel(), command.tau, command.q, command.v])

    def decode(self, data: bytes) -> JointCommand:
        message = decode(data, self.kind)
        joints, nj = message.initial_state.joint_state, len(self._matrix)
        gains = _numbers("feedback_gain", message.feedback_gain.data, self._matrix.size).reshape(self._matrix.shape)
        return JointCommand(
            q=_numbers("position", joints.position, nj),
            v=_numbers("velocity", joints.velocity, nj),
            tau=_numbers("feedforward", message.feedforward.data, nj),
            kp=gains[self._stiffness],
            kd=gains[self._damping],
        )


def command_codec(model: RobotModel, config: Ros2ControlConfig, mark: str) -> CommandCodec:
    """Codec of the configured command controller; ``MessageError`` when its message types are not built."""
    if config.command == "effort":
        return EffortCodec(model, mark, config.delay_margin * config.delay, 1.0 / config.rate)
    if config.command == "pvt":
        return PvtCodec(model, mark)
    return FeedbackCodec(model, mark, free_flyer=config.free_flyer)


def _gains(command: JointCommand, default: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
    return default[0] if command.kp is None else command.kp, default[1] if command.kd is None else command.kd


def _numbers(name: str, values: Sequence[float], count: int) -> Vector:
    """Values of a field (count,); ``MessageError`` for another number of values."""
    if len(values) != count:
        raise MessageError(f"{name}: {len(values)} values instead of {count}")
    return np.array(values, dtype=np.float64)


def _text(data: bytes, offset: int) -> str:
    """String in a serialised message, at the offset of its size; empty beyond the end."""
    size = int.from_bytes(data[offset : offset + 4], "little")
    return data[offset + 4 : offset + 4 + size].rstrip(b"\0").decode(errors="replace")
