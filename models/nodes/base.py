"""Base class of all nodes: lifecycle with reasons, counted refusals, diagnostics, status, real-time set-up."""

import re
import time
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any, NamedTuple, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_msgs.msg import String

from models.errors import MessageError, PoiseError
from models.nodes import realtime, topics
from models.nodes.parameters import declare, describe
from models.nodes.qos import EVENT, LATCHED, LATCHED_EVENT, QosWatch
from models.nodes.status import StatusMessage, status_from_message, status_to_message
from models.robot_model import RobotModel
from models.status import NodeStatus, Status

T = TypeVar("T", bound=Status)

LOG_PERIOD = 0.2  #: Minimum time between two reports of refusals of the same topic or service [s]
QUIET = 5.0  #: Time without a refusal after which the same cause counts as new [s]
CAUSES_MAX = 100  #: Maximum number of stored causes; the least recent ones are dropped
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")
ALARM_PERIOD = 0.05  #: Minimum time between two alarms on ``/diagnostics`` [s]


class _Cause(NamedTuple):
    """Refusals of one source for one cause."""

    times: int
    due: int  #: Number of refusals at which the next report is due
    last: float  #: Monotonic time of the latest refusal [s]
    error: str  #: Reason of the latest refusal


def cause_of(reason: str) -> str:
    """Reason with numbers replaced by ``#``; reasons that differ only in numbers are one cause."""
    return _NUMBER.sub("#", reason)


@cache
def shared_model(robot: str) -> RobotModel:
    """Robot model, loaded once per process."""
    return RobotModel.load(robot)


class PoiseNode(LifecycleNode):
    """Lifecycle node that reports the reasons of failed transitions and publishes refused inputs.

    Subclasses implement the hooks ``configure``, ``activate``, ``deactivate`` and ``cleanup``. A hook raises
    ``PoiseError`` to refuse a transition; any other exception is a programming error and is logged.

    ``AUTOSTART`` is the default of the parameter ``autostart``, with which a node configures and activates itself. It
    is set for nodes that only observe.

    Attributes:
        robot: Profile of the robot, by name or path.
        autostart: Value of the parameter of this name.
        active: Whether the node is active.
        counters: Refused inputs and other irregularities by kind, published as diagnostics.
        level: Level of the diagnostics.
        message: Message of the diagnostics.
        values: Further entries of the diagnostics.
    """

    AUTOSTART = False

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.robot = declare(self, "robot", "g1", "Robot profile, by name or path")
        period = declare(self, "diagnostics_period", 0.2, "Time between two diagnostics [s]", low=0.01, high=10.0)
        text = "Configure and activate at the start, when run as a separate process"
        self.autostart = declare(self, "autostart", self.AUTOSTART, text)
        self._declare_realtime()
        self.active = False
        self._owned: list[tuple[Callable[[Any], Any], Any]] = []
        self.counters: Counter[str] = Counter()
        self.level = DiagnosticStatus.OK
        self.message = "unconfigured"
        self.values: dict[str, str] = {}
        self._counted: Counter[str] = Counter()  # ``counters`` at the last diagnostics
        self._last_report: dict[str, float] = {}
        self._causes: dict[tuple[str, str], _Cause] = {}  # by source and cause
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._qos = QosWatch(self)
        watched = self._qos.publisher("/diagnostics", EVENT)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", EVENT, event_callbacks=watched)
        self._refusals = self.create_publisher(DiagnosticStatus, topics.REFUSALS, LATCHED_EVENT)
        self._node_status = self.create_publisher(StatusMessage, topics.NODE_STATUS, EVENT)
        self._last_alarm = -ALARM_PERIOD
        self.every(period, self._on_diagnostics_due)

    @property
    def model(self) -> RobotModel:
        """Model of the robot given by the parameter ``robot``."""
        return shared_model(self.robot)

    def bring_up(self) -> None:
        """Configure and activate; raises ``PoiseError`` with the reason of a refused transition."""
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() != TransitionCallbackReturn.SUCCESS:
                raise PoiseError(f"{self.get_name()}: {self.message}")

    def configure(self) -> None:
        """Build the law and create publishers, subscriptions and services."""

    def activate(self) -> None:
        """Start the work of the node; the law starts from its initial state."""

    def deactivate(self) -> None:
        """Stop the work of the node."""

    def cleanup(self) -> None:
        """Destroy all entities created with ``listen``, ``serve``, ``announce`` or ``own``."""
        while self._owned:
            destroy, entity = self._owned.pop()
            destroy(entity)

    def listen(
        self,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        qos: Any,
        *,
        raw: bool = False,
        while_active: bool = False,
        group: CallbackGroup | None = None,
    ) -> None:
        """Subscribe until ``cleanup``; see ``Node.create_subscription``, whose ``callback_group`` is ``group``.

        A callback raises ``PoiseError`` to refuse a message. With ``while_active`` an inactive node drops messages.
        """

        def on_message(message: Any) -> None:
            if self.active or not while_active:
                try:
                    callback(message)
                except PoiseError as error:
                    self.refuse(topic, error)

        watched = self._qos.subscription(topic, qos)
        subscription = self.create_subscription(
            kind, topic, on_message, qos, callback_group=group, raw=raw, event_callbacks=watched
        )
        self._owned += [(self._qos.forget, topic), (self.destroy_subscription, subscription)]

    def serve(self, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """Offer a service until ``cleanup``; see ``Node.create_service``."""
        self._owned.append((self.destroy_service, self.create_service(kind, name, callback)))

    def announce(self, kind: type, topic: str, qos: Any) -> Any:
        """Create a publisher, enabled while active, until ``cleanup``; see ``create_lifecycle_publisher``."""
        publisher = self.create_lifecycle_publisher(kind, topic, qos, event_callbacks=self._qos.publisher(topic, qos))
        self._owned += [(self._qos.forget, topic), (self.destroy_lifecycle_publisher, publisher)]
        return publisher

    def announce_status(self, topic: str, qos: Any = EVENT) -> Callable[[Status], None]:
        """Return a function that publishes a status record while the node is active, until ``cleanup``."""
        publisher = self.announce(StatusMessage, topic, qos)
        return lambda record: publisher.publish(self._status_message(record))

    def listen_status(
        self,
        kind: type[T],
        topic: str,
        callback: Callable[[T], None],
        qos: Any = EVENT,
        on_malformed: Callable[[], None] | None = None,
    ) -> None:
        """Subscribe to a status record until ``cleanup``; a malformed one is refused and ``on_malformed`` is called."""

        def on_message(message: Any) -> None:
            try:
                record = status_from_message(message, kind)
            except MessageError:
                if on_malformed is not None:
                    on_malformed()
                raise
            callback(record)

        self.listen(StatusMessage, topic, on_message, qos)

    def listen_start(self, callback: Callable[[], None]) -> None:
        """While active, call ``callback`` when the drivers hold the robot at its start, such as after a reset."""

        def on_state(message: String) -> None:
            if message.data == topics.HELD:
                callback()

        self.listen(String, topics.DRIVER_STATE, on_state, LATCHED, while_active=True)

    def own(self, destroy: Callable[[Any], Any], entity: Any) -> None:
        """Register an entity to be destroyed by ``cleanup``."""
        self._owned.append((destroy, entity))

    def every(self, period: float, callback: Callable[[], None]) -> Any:
        """Create a timer with a period [s] on the steady clock, independent of wall-clock jumps and ``/clock``."""
        return self.create_timer(period, callback, clock=self._steady)

    def refuse(self, source: str, error: Exception | str) -> None:
        """Count a refused input of a topic or service, and report the 1st, 10th, 100th, ... refusal of its cause.

        Reports go to the log (terminal and ``/rosout``) and to the latched topic ``refusals``. A report that is due
        within ``LOG_PERIOD`` of another report of the source is delayed to the next diagnostics after that time.
        """
        self.counters[f"refused {source}"] += 1
        self.values["last refusal"] = f"{source}: {error}"
        now, key = time.monotonic(), (source, cause_of(str(error)))
        count, due, last, _ = self._causes.pop(key, _Cause(0, 1, now, ""))
        count, due = (1, 1) if now - last > QUIET else (count + 1, due)
        self._causes[key] = _Cause(count, due, now, str(error))
        self._report_refusals(key)
        if len(self._causes) > CAUSES_MAX:
            del self._causes[next(iter(self._causes))]

    def _report_refusals(self, key: tuple[str, str]) -> None:
        """Report a cause if a report is due and the last report of the source is at least ``LOG_PERIOD`` old."""
        (source, _), (count, due, last, error), now = key, self._causes[key], time.monotonic()
        if count < due or now - self._last_report.get(source, -LOG_PERIOD) < LOG_PERIOD:
            return
        self._last_report[source] = now
        self._causes[key] = _Cause(count, 10 * count, last, error)
        named = f"{source}: {error}" if " refused" in error else f"{source} refused: {error}"
        text = named + (f" ({count} times)" if count > 1 else "")
        self.get_logger().warning(text)
        status = DiagnosticStatus(level=DiagnosticStatus.WARN, name=self.get_fully_qualified_name(), message=text)
        status.hardware_id = self.robot
        when = datetime.now(UTC) - timedelta(seconds=now - last)  # late subscribers receive old refusals, too
        items = {"source": source, "reason": error, "count": str(count), "time": when.isoformat(timespec="seconds")}
        status.values = [KeyValue(key=name, value=value) for name, value in items.items()]
        self._refusals.publish(status)

    def publish_diagnostics(self) -> None:
        """Publish the state of this node on ``/diagnostics`` (REP-107)."""
        self.before_diagnostics()
        incompatible = self._qos.values()
        news = incompatible | {key: f"{count} more" for key, count in (self.counters - self._counted).items()}
        self._counted = self.counters.copy()
        level = DiagnosticStatus.WARN if self.level == DiagnosticStatus.OK and news else self.level
        message = "; ".join([self.message, *(f"{key}: {text}" for key, text in news.items())])
        status = DiagnosticStatus(level=level, name=self.get_fully_qualified_name(), message=message)
        status.hardware_id = self.robot
        items = {**self.values, **incompatible, **{key: str(count) for key, count in self.counters.items()}}
        status.values = [KeyValue(key=key, value=value) for key, value in items.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
        self._node_status.publish(self._status_message(NodeStatus(self.get_name(), *self._qos.mismatches())))

    def _status_message(self, record: Status) -> Any:
        return status_to_message(record, self.get_fully_qualified_name(), self.get_clock().now().to_msg())

    def alarm(self) -> None:
        """Publish the diagnostics at once; within ``ALARM_PERIOD`` of the last alarm, leave it to the timer."""
        now = time.monotonic()
        if now - self._last_alarm >= ALARM_PERIOD:
            self._last_alarm = now
            self.publish_diagnostics()

    def _on_diagnostics_due(self) -> None:
        """Check QoS, publish diagnostics and due reports, then collect garbage; runs between ticks."""
        self._qos.look()
        self.publish_diagnostics()
        for key in tuple(self._causes):
            self._report_refusals(key)
        if self.active:
            realtime.collect()

    def before_diagnostics(self) -> None:
        """Update ``level``, ``message`` and ``values``; called before each publication."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; see ``configure``. A failed transition destroys what it created."""
        result = self._transition("configured", self.configure, state, super().on_configure)
        if result != TransitionCallbackReturn.SUCCESS:
            self.cleanup()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; see ``activate``."""
        result = self._transition("active", self.activate, state, super().on_activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        if self.active:
            self._set_up_realtime()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; see ``deactivate``."""
        self.active = False
        return self._transition("inactive", self.deactivate, state, super().on_deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition; see ``cleanup``."""
        return self._transition("unconfigured", self.cleanup, state, super().on_cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lifecycle transition: deactivate an active node."""
        was_active, self.active = self.active, False
        return self._transition(
            "finalized", self.deactivate if was_active else lambda: None, state, super().on_shutdown
        )

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Return to unconfigured after a programming error in a transition; destroys all entities."""
        self.active = False
        self.cleanup()
        return TransitionCallbackReturn.SUCCESS

    def _LifecycleNodeMixin__change_state(self, transition_id: int) -> TransitionCallbackReturn:
        """Refuse a transition that is not available in the current state.

        In rclpy this error propagates from the service callback and ends the process. A request repeated after a late
        reply must not stop a robot.
        """
        possible = {transition[0]: transition[1] for transition in self._state_machine.available_transitions}
        if transition_id not in possible:
            here = self._state_machine.current_state[1]
            self.refuse("change_state", f"transition {transition_id} from state '{here}'; possible: {possible}")
            return TransitionCallbackReturn.FAILURE
        return super()._LifecycleNodeMixin__change_state(transition_id)  # type: ignore[misc]  # rclpy has no hook

    def _transition(
        self,
        label: str,
        hook: Callable[[], None],
        state: LifecycleState,
        base: Callable[[LifecycleState], TransitionCallbackReturn],
    ) -> TransitionCallbackReturn:
        try:
            hook()
        except PoiseError as error:
            self.level, self.message = DiagnosticStatus.ERROR, str(error)
            self.get_logger().error(f"not {label}: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # rclpy would hide it; log it, then the state machine handles it
            self.level, self.message = DiagnosticStatus.ERROR, f"{type(error).__name__}: {error}"
            self.get_logger().fatal(f"not {label}: {type(error).__name__}: {error}")
            return TransitionCallbackReturn.ERROR
        self.level, self.message = DiagnosticStatus.OK, label
        return base(state)

    def _declare_realtime(self) -> None:
        self.declare_parameter("realtime.priority", 0, describe("SCHED_FIFO priority, 0 for none", integer=(0, 99)))
        self.declare_parameter(
            "realtime.lock_memory", False, describe("Whether to lock the memory of the process (mlockall)")
        )
        self.declare_parameter("realtime.cores", [-1], describe("Cores to run on; [-1] for any"))
        text = describe("Whether to pin the process to a core that no other such process uses; needs realtime.priority")
        self.declare_parameter("realtime.own_core", False, text)

    def _set_up_realtime(self) -> None:
        log = self.get_logger().info
        scheduled = realtime.use_fifo(int(self.get_parameter("realtime.priority").value), log)
        if self.get_parameter("realtime.lock_memory").value:
            realtime.lock_memory(log)
        cores = [int(c) for c in self.get_parameter("realtime.cores").value if c >= 0]
        if cores:
            realtime.pin_to(cores, log)
        elif scheduled and self.get_parameter("realtime.own_core").value:
            realtime.take_core(log)
        realtime.settle()
