"""Messages of a gait in two processes: commands of the gait planner, and the state of the executed gait.

The gait planner determines where to walk. The balance controller executes the gait and adjusts its steps in every tick.
A message is a std_msgs/UInt8MultiArray with one record of this module in MessagePack, validated on arrival.
"""

import math
import zlib
from array import array
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar, get_origin

import numpy as np
from msgspec import MsgspecError, Struct, msgpack
from msgspec.structs import replace
from std_msgs.msg import UInt8MultiArray

from models.config import default_config
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.parameters import declare_config
from models.nodes.qos import EVENT, STATE
from models.robot_model import RobotModel
from models.types import STILL, Velocity
from planners.gait.config import GaitConfig
from planners.gait.footsteps import Foothold
from planners.gait.planner import GaitPlanner
from planners.gait.route import Footstep, Route
from planners.gait.scaling import load_gait_config
from planners.gait.state import GaitState

T = TypeVar("T", bound=Struct)


class Stop(Struct, frozen=True, tag=True):
    """Come to a standstill."""


class WalkTo(Struct, frozen=True, tag=True):
    """Walk to a pose."""

    goal: Foothold


class TakeSteps(Struct, frozen=True, tag=True):
    """Take footsteps."""

    steps: tuple[Footstep, ...]
    after: int | None = None  # see ``GaitPlanner.take_steps``


class GaitCommand(Struct, frozen=True):
    """Newest command; repeated as a heartbeat of the planner, and executed once."""

    number: int = 0  # of the command; 0 after a start of the planner
    command: Stop | WalkTo | TakeSteps | None = None
    velocity: Velocity = STILL  # applied at every tick until the next message [m/s, m/s, rad/s]

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, self.velocity)):
            raise ValueError(f"velocity {self.velocity} is not finite")


class GaitReport(Struct, frozen=True):
    """State of the gait after a tick."""

    stamp: int  # of the tick [ns]
    config: int  # checksum of the configuration
    number: int | None  # of the last command received; None before the first
    refusal: str  # reason why it was refused; empty if it was accepted
    walking: bool  # the gait follows its commands
    state: GaitState


def encode(record: Struct) -> Any:
    """Message with a record."""
    data = msgpack.encode(record, enc_hook=lambda value: value.tolist())
    return UInt8MultiArray(data=array("B", data))


def decode(kind: type[T], message: Any) -> T:
    """Record in a message; ``MessageError`` names a field of a wrong type."""
    try:
        return msgpack.decode(bytes(message.data), type=kind, dec_hook=_array)
    except (MsgspecError, UnicodeDecodeError, RecursionError) as error:  # the last two: invalid text, deep nesting
        raise MessageError(f"{kind.__name__}: {error}") from error


def _array(kind: Any, value: Any) -> Any:
    if get_origin(kind) is not np.ndarray:
        raise NotImplementedError(kind)
    return np.array(value, dtype=float)


def declare_gait(node: PoiseNode, prefix: str = "") -> GaitConfig:
    """Declare the gait of the robot, or the default if it cannot be loaded; ``configure`` then reports the error."""
    try:
        default = load_gait_config(node.model)
    except PoiseError:
        default = default_config(GaitConfig, "planners", "gait")
    return declare_config(node, default, prefix)


def checksum(config: GaitConfig) -> int:
    """Checksum of a configuration; equal if all values are equal."""
    return zlib.crc32(repr(config).encode())


class GaitStage(Protocol):
    """Gait of the control stack, in this process or another one."""

    walking: bool

    def build_gait(self, robot: RobotModel, config: GaitConfig) -> GaitPlanner:
        """Build the gait planner, or replace it."""

    def hold_velocity(self, forward: float, left: float, turn: float) -> None:
        """Repeat a velocity [m/s, m/s, rad/s] at every tick from now on."""

    def stop(self) -> None:
        """Come to a standstill."""

    def walk_to(self, goal: Foothold) -> None:
        """Walk to a pose."""

    def take_steps(self, steps: Sequence[Footstep], after: int | None = None) -> None:
        """Take footsteps; see ``GaitPlanner.take_steps``."""


class RemoteGait:
    """Gait of a balance controller in another process: publishes commands and keeps a copy of the state.

    A command changes the copy at once; states from before the controller received it are ignored. ``on_report`` is
    called with the stamp of each report [ns]. The answer to a report is the newest command.
    """

    def __init__(self, node: PoiseNode, on_report: Callable[[int], None]) -> None:
        self._node, self._on_report = node, on_report
        self.walking = False

    def build_gait(self, robot: RobotModel, config: GaitConfig) -> GaitPlanner:
        """Create the copy, the publisher and the subscriber."""
        self._law, self._config = GaitPlanner(robot, config), checksum(config)
        self._newest, self.walking = GaitCommand(), False
        self._commands = self._node.announce(UInt8MultiArray, topics.GAIT_COMMAND, EVENT)
        self._node.listen(UInt8MultiArray, topics.GAIT_STATE, self._on_state, STATE, while_active=True)
        return self._law

    def hold_velocity(self, forward: float, left: float, turn: float) -> None:
        """Set the velocity that the controller repeats [m/s, m/s, rad/s]; it is sent with the next answer."""
        self._newest = replace(self._newest, velocity=(forward, left, turn))

    def stop(self) -> None:
        """Come to a standstill."""
        self._law.stop()
        self._send(Stop())

    def walk_to(self, goal: Foothold) -> None:
        """Walk to a pose; see ``GaitPlanner.walk_to``."""
        self._law.walk_to(goal)
        self._send(WalkTo(goal))

    def take_steps(self, steps: Sequence[Footstep], after: int | None = None) -> None:
        """Take footsteps; see ``GaitPlanner.take_steps``."""
        self._law.take_steps(steps, after)
        self._send(TakeSteps(tuple(steps), after))

    def _send(self, command: Stop | WalkTo | TakeSteps) -> None:
        """Publish a command with zero velocity; the present velocity would end a route."""
        self._newest = GaitCommand(self._newest.number + 1, command)
        self._commands.publish(encode(self._newest))

    def _on_state(self, message: Any) -> None:
        report = decode(GaitReport, message)
        if report.config != self._config:
            raise MessageError(
                "balance_controller has another gait: its parameters gait.* must equal those of this node"
            )
        if report.number == self._newest.number:
            self._law.state, self.walking = report.state, report.walking
            if report.refusal:
                command = report.state.command
                self._law.state.command = replace(command, route=Route(outcome=report.refusal))
        self._on_report(report.stamp)
        self._commands.publish(encode(self._newest))
