"""Node ``balance_controller``: state in, one joint command for each state out while the mode lets the robot move."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from controllers.balance import BalanceController
from controllers.head import Head, HeadConfig
from controllers.joint_monitor import JointMonitor
from controllers.law_switch import LawSwitch
from controllers.nodes.black_box_keeper import BlackBoxKeeper
from controllers.nodes.gain_parameters import GainParameters
from controllers.nodes.head_topics import HeadTopics
from controllers.nodes.motion_topics import MotionTopics
from controllers.nodes.state_topics import StateTopics
from controllers.supervisor import ACTIVE_MODES
from controllers.tuning import TUNABLE
from controllers.walker import Gait, Walker
from controllers.walking import WalkingConfig, WalkingController
from controllers.whole_body_config import BalanceConfig, WholeBodyConfig
from models.applied import Applied
from models.config import default_config
from models.errors import MessageError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import JointCommandCodec, JointStateCodec
from models.nodes.modes import mode_named
from models.nodes.parameters import declare_config, describe
from models.nodes.qos import LATCHED, SENSOR, command
from models.nodes.spin import run
from models.nodes.tick_timer import TickTimer
from models.types import ControlResult, Mode, RobotState, SensorData, SolveStatus

OVERRUNS_TOLD = 10
"""Ticks in a row over their budget after which the diagnostics do not wait for their timer."""

FIRST_STEP = 0.001
"""Step of the first tick after a reset, when there is no earlier stamp [s]."""


class BalanceControllerNode(PoiseNode):
    """Runs ``BalanceController`` once for each state, in mode ``walk`` ``WalkingController`` on the gait's reference.

    Args:
        local: Whether an estimator in this process calls ``on_state``; otherwise the state comes from topics.
        gait: Gait planner in this process; without one the robot does not walk.
        applied: Notes what the laws are told, for a replay; None for nobody.
        kwargs: Passed to rclpy.

    Attributes:
        scheduled: Which feet the last tick's reference has in contact; None while the mode moves nothing.
    """

    def __init__(
        self, *, local: bool = False, gait: Gait | None = None, applied: Applied | None = None, **kwargs: Any
    ) -> None:
        super().__init__("balance_controller", **kwargs)
        self._local, self._gait, self._applied = local, gait, applied
        balance = default_config(BalanceConfig, "controllers", "balance")
        self._balance = declare_config(self, balance, "balance.", TUNABLE)
        whole_body = default_config(WholeBodyConfig, "controllers", "whole_body")
        self._whole_body = declare_config(self, whole_body, "whole_body.", TUNABLE)
        self._gains = GainParameters(self, self._balance, self._whole_body, applied)
        walking = default_config(WalkingConfig, "controllers", "walking")
        self._walking = declare_config(self, walking, "walking.")
        whole_body = default_config(WholeBodyConfig, "controllers", "whole_body_walking")
        self._whole_body_walking = declare_config(self, whole_body, "whole_body_walking.")
        self._head_config = declare_config(self, default_config(HeadConfig, "controllers", "head"), "head.")
        self._lockstep = topics.declare_lockstep(self)
        text = describe("Offered deadline of the joint command [s]", low=0.002, high=1.0)
        self._deadline = float(self.declare_parameter("command_deadline", 0.02, text).value)
        text = describe("Rate of the reference posture, which planners start from [Hz]", low=1.0, high=1000.0)
        self._posture_period = round(NANOSECONDS / float(self.declare_parameter("posture_rate", 50.0, text).value))
        text = describe("Time a tick of the law may take; more is counted, and damps when it goes on [s]", low=1e-5)
        self._budget = float(self.declare_parameter("tick_budget", 0.001, text).value)
        self._overruns = 0
        self._joint_fault = ""
        self._mode = Mode.OFF
        self._reset = True
        self._last_stamp = self._last_posture = 0
        self._result: ControlResult | None = None
        self._last_command = b""
        self.scheduled: tuple[bool, bool] | None = None
        self._timer = TickTimer()
        self._black_box = BlackBoxKeeper(self, applied)

    def configure(self) -> None:
        """Build the law, the codecs and the topics."""
        head = Head.of(self.model, self._head_config)
        self._law = BalanceController(self.model, self._balance, self._whole_body, head=head)
        self._gains.start(self._law)
        self._tracker: WalkingController | None = None
        self._laws = LawSwitch(self._law, self._make_walker(), JointMonitor(self.model), self._applied, head)
        if self._applied is not None:
            for name in ("balance", "whole_body", "walking", "whole_body_walking"):
                self._applied.describe(name, getattr(self, f"_{name}"))
            self._applied.describe("head", self._head_config)
            self._applied.watch("balance", self._law)
        self._codec, self._posture_codec = JointCommandCodec(self.model), JointStateCodec(self.model)
        self._command = self.announce(JointTrajectory, topics.JOINT_COMMAND, command(self._deadline))
        self._posture = self.announce(JointState, topics.POSTURE, SENSOR)
        self.listen(String, topics.MODE, self._on_mode, LATCHED)
        self._motions = MotionTopics(self, self._laws, lambda: self._mode, self._applied)
        self._head = HeadTopics(self, self._laws, lambda: self._mode)
        self._black_box.configure()
        if not self._local:
            self._topics = StateTopics(self, self._on_topics, reliable=self._lockstep)

    def _make_walker(self) -> Callable[[], Walker[Gait]] | None:
        if self._gait is None:
            return None
        self._tracker = WalkingController(self.model, self._walking, self._whole_body_walking)
        walker = Walker(self._gait, self._tracker, head=self._law.head)
        if self._applied is not None:
            self._applied.watch("walker", walker, (self._gait,))
        return lambda: walker

    def activate(self) -> None:
        """Start from the next state."""
        self._reset = True
        self._overruns = 0
        self._result = None

    def deactivate(self) -> None:
        """Forget the motion."""
        self._motions.forget()
        self._black_box.flush()

    def _on_topics(self, state: RobotState, stamp: int) -> None:
        """Answer a state from topics, with which no sensors come."""
        self.on_state(state, stamp)
        self.keep(state)

    def keep(self, state: RobotState, sensors: SensorData | None = None, stamp: int | None = None) -> None:
        """Have the black box keep a tick, once its command is out.

        Args:
            state: Estimated state.
            sensors: What it was made from, where that is known.
            stamp: Of the tick, where it is known [ns].
        """
        result = None if self.scheduled is None else self._result
        self._black_box.add(state, sensors, result, self._mode, stamp)
        if result is not None:
            self._black_box.checkpoint(state, self.scheduled, walking=self._laws.walking)

    def on_state(self, state: RobotState, stamp: int) -> None:
        """Answer one state with one command.

        Args:
            state: Estimated state.
            stamp: Its stamp [ns], which the command carries.
        """
        if not self.active or self._mode not in ACTIVE_MODES:
            self.scheduled = None
            self._note("run", False)
            return
        if self._lockstep and not self._reset and stamp == self._last_stamp:
            self._command.publish(self._last_command)  # the plant asks again: the answer was lost
            return
        if not self._reset and stamp <= self._last_stamp:
            self.refuse(topics.ODOM, f"header.stamp: {stamp} ns is not after {self._last_stamp} ns")
            return
        dt = FIRST_STEP if self._reset else (stamp - self._last_stamp) / NANOSECONDS
        self._note("run", True)
        self._note("law_dt", dt)
        if self._reset:
            self._laws.reset(state)
            self._reset = False
        self._last_stamp = stamp
        with self._timer:
            self._gains.step(dt)
            self._laws.enter(self._mode, state)
            result = self._laws.step(state, dt)
        self.scheduled = self._laws.reference.contacts
        self._last_command = self._codec.encode(stamp, result.command)
        self._command.publish(self._last_command)
        self._after(state, result, stamp)
        if not self._lockstep:
            self._judge_time()

    def _note(self, word: str, value: object) -> None:
        """Note a change for a replay."""
        if self._applied is not None:
            self._applied.note_change(word, value)

    def _after(self, state: RobotState, result: ControlResult, stamp: int) -> None:
        """What need not precede the command: posture, motion state, alarms."""
        worse = self._result is not None and result.status is not self._result.status
        if self._laws.joint_fault != self._joint_fault:
            self._joint_fault = self._laws.joint_fault
            self.alarm()
        self._result = result
        if stamp - self._last_posture >= self._posture_period or stamp < self._last_posture:
            self._last_posture = stamp
            self._posture.publish(self._posture_codec.encode(stamp, *self._laws.posture, result.command.tau))
            self._head.tell(state, stamp)
        self._motions.tell_end()
        if worse and result.status in (SolveStatus.HELD, SolveStatus.DAMPED):
            self.counters[result.status.value] += 1
            self.alarm()

    def _judge_time(self) -> None:
        """Count ticks over their budget; the supervisor is told as soon as they go on."""
        if self._timer.last <= self._budget:
            self._overruns = 0
            return
        self.counters["ticks over budget"] += 1
        self._overruns += 1
        if self._overruns % OVERRUNS_TOLD == 0:
            self.alarm()

    def before_diagnostics(self) -> None:
        """Report the newest result; write the black box when it is time."""
        self._black_box.poll()
        result = self._result
        if not self.active or result is None:
            return
        moving = self._mode in ACTIVE_MODES
        bad = moving and result.status in (SolveStatus.HELD, SolveStatus.DAMPED)
        self.level = DiagnosticStatus.ERROR if bad else DiagnosticStatus.OK
        self.message = result.status.value if moving else f"idle in mode '{self._mode.value}'"
        self.values[topics.OVERRUNS], self.values[topics.JOINT_FAULT] = str(self._overruns), self._joint_fault
        self.values["residual"] = f"{result.residual:.3g}"
        self.values["capture margin [m]"] = (
            f"{(self._tracker if self._laws.walking and self._tracker else self._law).capture_margin:.4f}"
        )
        self.values["solve time [us]"] = f"{1e6 * result.solve_time:.0f}"
        self.values |= self._timer.values()

    def _on_mode(self, message: String) -> None:
        try:
            before, self._mode = self._mode, mode_named(message.data)
        except MessageError as error:
            self.refuse(topics.MODE, error)
            return
        if before not in ACTIVE_MODES:
            self.activate()
            self._motions.forget()


def main(args: list[str] | None = None) -> None:
    """Run the node in a process of its own; the state comes from topics."""
    sys.exit(run([BalanceControllerNode], args))


if __name__ == "__main__":
    main()
