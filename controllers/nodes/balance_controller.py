"""Node ``balance_controller``: publishes one joint command per state while the mode lets the robot move."""

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from msgspec.structs import replace
from rcl_interfaces.msg import FloatingPointRange
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from controllers.balance.head import HeadConfig
from controllers.balance.tuning import FACTOR, TUNABLE, configured
from controllers.nodes.black_box_keeper import BlackBoxKeeper
from controllers.nodes.gait_executor import GaitExecutor
from controllers.nodes.motion_topics import HeadTopics, MotionTopics
from controllers.nodes.sample_topics import StateTopics
from controllers.safety.supervisor import ACTIVE_MODES
from controllers.stack import ControlStack, StackConfig
from controllers.whole_body.config import (
    BalanceConfig,
    WholeBodyConfig,
    load_balance_config,
    load_whole_body_config,
)
from models.config import default_config
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import JointCommandCodec, JointStateCodec, mode_named
from models.nodes.parameters import declare, declare_config, declare_lockstep, declare_period, describe
from models.nodes.qos import LATCHED, STATE, command, sensor
from models.nodes.realtime import TickTimer
from models.nodes.spin import program
from models.types import ControlResult, Mode, RobotState, SolveStatus

FORCE = "force_deactivate"  #: Parameter that allows deactivation while the robot stands
OVERRUNS_REPORTED = 10  #: Consecutive ticks over budget after which diagnostics are published at once


class BalanceControllerNode(PoiseNode):
    """Runs the whole-body laws of a control stack once per state.

    ``stack`` is shared with the gait planner and with the estimator of this process, which calls ``on_state``. When
    None, states and gait commands come from topics, and this node builds the gait.
    """

    def __init__(self, stack: ControlStack | None = None, **kwargs: Any) -> None:
        super().__init__("balance_controller", **kwargs)
        self._stack = stack or ControlStack()
        self._gait = GaitExecutor(self, self._stack) if stack is None else None
        balance, whole_body = self._configured()
        self._balance = declare_config(self, balance, "balance.", TUNABLE)
        self._whole_body = declare_config(self, whole_body, "whole_body.", TUNABLE)
        self._bound_gains()
        self.add_post_set_parameters_callback(self._on_gains)
        self._head_config = declare_config(self, default_config(HeadConfig, "controllers", "head"), "head.")
        self._lockstep, self._waits = declare_lockstep(self)
        text = "Offered deadline of the joint command [s]"
        self._deadline = declare(self, "command_deadline", 0.02, text, low=0.002, high=1.0)
        self._posture_period = declare_period(self, "posture_rate", 50.0, "the reference posture, the start of plans")
        text = "Rate of the states [Hz]; the joint monitor uses it"
        self._period = 1.0 / declare(self, "sensor_rate", 1000.0, text, low=1.0, high=10000.0)
        text = "Real time for the computation of a tick [s]; 0: the period of the states"
        self._budget = declare(self, "time_budget", 0.0, text, low=0.0, high=1.0) or self._period
        text = describe("Whether the node may be deactivated while it balances the robot", read_only=False)
        self.declare_parameter(FORCE, False, text)
        self._overruns = 0
        self._joint_fault = ""
        self._mode = Mode.OFF
        self._reset = True
        self._last_stamp = self._last_posture = 0
        self._result: ControlResult | None = None
        self._last_command = b""
        self._timer = TickTimer()
        self._black_box = BlackBoxKeeper(self, self._stack)

    def _configured(self) -> tuple[BalanceConfig, WholeBodyConfig]:
        """Parameters of the robot, or the defaults if it cannot be loaded, which ``configure`` reports."""
        try:
            return load_balance_config(self.model), load_whole_body_config(self.model)
        except PoiseError:
            balance = default_config(BalanceConfig, "controllers", "balance")
            return balance, default_config(WholeBodyConfig, "controllers", "whole_body")

    def configure(self) -> None:
        if self._gait is not None:
            self._gait.configure()
        config = StackConfig(balance=self._balance, whole_body=self._whole_body, head=self._head_config)
        self._stack.build_law(self.model, config, period=self._period)
        if (tuning := self._stack.tuning) is not None:  # the new law does not run yet: gains change at once
            for name in TUNABLE:
                tuning.set(name, float(self.get_parameter(name).value))
            tuning.finish()
        self._codec, self._posture_codec = JointCommandCodec(self.model), JointStateCodec(self.model)
        self._command = self.announce(JointTrajectory, topics.JOINT_SETPOINTS, command(self._deadline))
        self._publish_status = self.announce_status(topics.CONTROL_STATUS)
        self._posture = self.announce(JointState, topics.POSTURE, STATE)
        self.listen(String, topics.MODE, self._on_mode, LATCHED)
        self._motions = MotionTopics(self, self._stack, lambda: self._mode)
        self._head = HeadTopics(self, self._stack, lambda: self._mode)
        self._black_box.configure()
        if self._gait is not None:
            qos = sensor(lockstep=self._lockstep, waits=self._waits)
            self._topics = StateTopics(self, self.on_state, qos)

    def activate(self) -> None:
        self._reset = True
        self._overruns = 0
        self._result = None

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; refused in active modes, where the robot would fall, unless forced."""
        if self._mode in ACTIVE_MODES and not self.get_parameter(FORCE).value:
            self.refuse(
                "deactivate",
                f"the robot would fall in mode '{self._mode.value}': poise mode damp first, with the robot held, "
                f"or force it: ros2 param set {self.get_fully_qualified_name()} {FORCE} true",
            )
            return TransitionCallbackReturn.FAILURE
        return super().on_deactivate(state)

    def deactivate(self) -> None:
        self._motions.end("the controller was deactivated")
        self._black_box.flush()

    def on_state(self, state: RobotState, stamp: int) -> None:
        """Compute and publish the joint command of one state, with the stamp of the state [ns]."""
        stack = self._stack
        stack.set_state(state)
        if not self.active or self._mode not in ACTIVE_MODES:
            stack.enter(self._mode if self.active else Mode.OFF)
            stack.control(0.0)
            self._keep(stamp)
            return
        if self._waits and not self._reset and stamp == self._last_stamp:
            self._command.publish(self._last_command)  # the plant repeats its sample: the command was lost
            return
        if not self._reset and stamp <= self._last_stamp:
            self.refuse(topics.ODOM, f"header.stamp: {stamp} ns is not after {self._last_stamp} ns")
            return
        dt = self._period if self._reset else (stamp - self._last_stamp) / NANOSECONDS
        if self._reset:
            stack.reset_law(state)
            self._reset = False
        self._last_stamp = stamp
        with self._timer:
            stack.enter(self._mode)
            result = stack.control(dt)
        assert result is not None  # the mode is an active one
        self._last_command = self._codec.encode(stamp, result.command)
        # Without a setpoint the drivers damp, so a damped result is not published.
        if self._waits or result.status is not SolveStatus.DAMPED:
            self._command.publish(self._last_command)
        self._after(state, result, stamp)
        self._keep(stamp)
        if not self._waits:
            self._judge_time()

    def _keep(self, stamp: int) -> None:
        """Record the tick in the black box and report the gait, after the command is published."""
        self._black_box.add(self._stack.raw if self._gait is None else None, self._mode, stamp)
        if self._gait is not None:
            self._gait.update(stamp)

    def _after(self, state: RobotState, result: ControlResult, stamp: int) -> None:
        """Publish posture, motion state and alarms, which may follow the command."""
        worse = self._result is not None and result.status is not self._result.status
        if self._stack.joint_fault != self._joint_fault:
            self._joint_fault = self._stack.joint_fault
            self.alarm()
        self._result = result
        if stamp - self._last_posture >= self._posture_period or stamp < self._last_posture:
            self._last_posture = stamp
            self._posture.publish(self._posture_codec.encode(stamp, *self._stack.posture, result.command.tau))
            self._head.publish(state, stamp)
        self._motions.publish_end()
        if worse and result.status in (SolveStatus.HELD, SolveStatus.DAMPED):
            self.counters[result.status.value] += 1
            self.alarm()

    def _judge_time(self) -> None:
        if self._timer.last <= self._budget:
            self._overruns = 0
            return
        self.counters["ticks over budget"] += 1
        self._overruns += 1
        if self._overruns % OVERRUNS_REPORTED == 0:
            self.alarm()

    def before_diagnostics(self) -> None:
        self._black_box.poll()
        result = self._result
        if not self.active or result is None:
            return
        moving = self._mode in ACTIVE_MODES
        bad = moving and result.status in (SolveStatus.HELD, SolveStatus.DAMPED)
        self.level = DiagnosticStatus.ERROR if bad else DiagnosticStatus.OK
        self.message = result.status.value if moving else f"idle in mode '{self._mode.value}'"
        status, (median, tail) = self._stack.status, self._timer.percentiles()
        status = replace(status, active=moving, overruns=self._overruns, tick_median_us=median, tick_tail_us=tail)
        self._publish_status(replace(status, gait_silent=self._gait is not None and self._gait.silent))
        self.values["ticks over budget in a row"] = str(self._overruns)
        self.values["joint at fault"] = self._joint_fault
        self.values["delay of the commands [ms]"] = f"{1e3 * self._stack.delay:.0f}"
        self.values["residual"] = f"{result.residual:.3g}"
        self.values["capture margin [m]"] = f"{self._stack.capture_margin:.4f}"
        self.values["solve time [us]"] = f"{1e6 * result.solve_time:.0f}"
        self.values |= self._timer.values()

    def _on_mode(self, message: String) -> None:
        before, self._mode = self._mode, mode_named(message.data)
        if self._mode not in ACTIVE_MODES or (self._mode is Mode.WALK and before is not Mode.WALK):
            self._motions.end(f"mode '{self._mode.value}'")
        if before not in ACTIVE_MODES:
            self.activate()

    def _bound_gains(self) -> None:
        """Bound live gains to within ``FACTOR`` of the configured values; rclpy refuses others, naming both bounds."""
        for name in TUNABLE:
            value, descriptor = configured(name, self._balance, self._whole_body), self.describe_parameter(name)
            descriptor.floating_point_range = [FloatingPointRange(from_value=value / FACTOR, to_value=value * FACTOR)]
            self.set_descriptor(name, descriptor)

    def _on_gains(self, parameters: list[Any]) -> None:
        tuning = self._stack.tuning
        for parameter in parameters:
            if tuning is not None and parameter.name in TUNABLE:
                low, high = tuning.ranges[parameter.name]
                value = min(max(float(parameter.value), low), high)  # rclpy tolerates an excess of a millionth
                self._stack.set_gain(parameter.name, value)
                self.get_logger().info(f"{parameter.name}: {value:g}")


main = program(BalanceControllerNode)  #: Separate process: the state comes from topics


if __name__ == "__main__":
    main()
