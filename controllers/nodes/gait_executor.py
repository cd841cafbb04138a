"""Gait of a controller with its gait planner in another process."""

from typing import Any

from std_msgs.msg import UInt8MultiArray

from controllers.estimation.stamps import Due
from controllers.stack import ControlStack
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.parameters import declare_ns, declare_period
from models.nodes.qos import EVENT, STATE
from planners.nodes.gait_link import (
    GaitCommand,
    GaitReport,
    Stop,
    TakeSteps,
    WalkTo,
    checksum,
    declare_gait,
    decode,
    encode,
)


class GaitExecutor:
    """Builds the gait of a stack, executes the commands of the planner, and reports the gait to it.

    The planner is ``silent`` when it has not answered reports for ``gait_timeout``; the robot then stands, or comes to
    a standstill. A command is executed when its number has changed, but never the first message.
    """

    def __init__(self, node: PoiseNode, stack: ControlStack) -> None:
        self._node, self._stack = node, stack
        self._config = declare_gait(node, "gait.")
        self._period = declare_period(node, "gait_state_rate", 50.0, "the state of the gait for the gait planner")
        text = "Timeout of the gait planner, after which the robot comes to a standstill [s]"
        self._timeout = declare_ns(node, "gait_timeout", 0.5, text, low=0.05, high=10.0)
        self.silent = True

    def configure(self) -> None:
        """Build the gait and the topics."""
        self._gait, self._checksum = self._stack.build_gait(self._node.model, self._config), checksum(self._config)
        self._due, self._phase = Due(self._period), self._gait.phase
        self._number: int | None = None
        self._refusal, self.silent = "", True
        self._stamp = self._answered = 0
        self._reports = self._node.announce(UInt8MultiArray, topics.GAIT_STATE, STATE)
        self._node.listen(UInt8MultiArray, topics.GAIT_COMMAND, self._on_command, EVENT, while_active=True)

    def update(self, stamp: int) -> None:
        """After each tick with its stamp [ns]: report if due or after a change of phase, and check for silence."""
        self._stamp, phase, due = stamp, self._gait.phase, self._due(stamp)
        if due or phase is not self._phase:
            self._phase = phase
            walking, state = self._stack.walking, self._gait.state
            report = GaitReport(stamp, self._checksum, self._number, self._refusal, walking, state)
            self._reports.publish(encode(report))
        if not self.silent and not 0 <= stamp - self._answered <= self._timeout:
            self._set_silent(True)
            self._stack.stop()

    def _set_silent(self, silent: bool) -> None:
        self.silent = silent
        self._node.alarm()

    def _on_command(self, message: Any) -> None:
        newest = decode(GaitCommand, message)
        self._answered = self._stamp
        if self.silent:
            self._set_silent(False)
        before, self._number = self._number, newest.number
        if before not in (None, newest.number):
            self._carry_out(newest)
        self._stack.hold_velocity(*newest.velocity)

    def _carry_out(self, newest: GaitCommand) -> None:
        """Execute a command; a refused one ends the walk, except footsteps that are too late to replace others."""
        self._refusal = ""
        try:
            match newest.command:
                case Stop():
                    self._stack.stop()
                case WalkTo(goal):
                    self._stack.walk_to(goal)
                case TakeSteps(steps, after):
                    self._stack.take_steps(steps, after)
        except PoiseError as error:
            if not (isinstance(newest.command, TakeSteps) and newest.command.after is not None):
                self._refusal = str(error)
                self._stack.stop()
            raise
