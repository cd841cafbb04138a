"""A short-lived participant of the graph, for commands to a running robot."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool, Trigger

from bridge.ros.environment import (
    graph_holder,
    graphs_elsewhere,
    namespaces_of_robots,
    other_namespaces,
    participant,
)
from bridge.ros.namespace import absolute_namespace
from models.errors import CommandError
from models.nodes import topics
from models.nodes.calibration_text import text_to_reply
from models.nodes.qos import EVENT, LATCHED, LATCHED_EVENT
from models.nodes.status import subscribe_status
from models.status import (
    GET_UP,
    GaitStatus,
    MotionState,
    MotionStatus,
    RouteState,
    RouteStatus,
    StartStatus,
    SupervisorStatus,
)
from models.types import CommandReply, Mode

if TYPE_CHECKING:
    from controllers.commands.command_signature import Signer

PLANNING = 0.5  #: Longest wait for the plan of a motion [s]; the reply afterwards is that it was requested
DISCOVERY = 0.5  #: Time in which a new participant discovers the others [s]; no command is sent earlier
LIMITING = 0.3  #: Longest wait for a report of the gait planner that it limits a velocity [s]
SETTLE_TIME = 0.2  #: Time for a service to discover its new client [s]; its answer would be lost before
SPIN = 0.01  #: Longest wait for a callback between two checks of a condition [s]
STOP = "stop"  #: Command that every source may send; it is never signed, so that no signature can be refused


def signed(text: str, signer: Signer | None) -> str:
    """Text to send, signed unless ``signer`` is None; ``CommandError`` when it cannot be signed."""
    return text if signer is None or text.strip().lower() == STOP else signer.sign(text)


class Client:
    """Sends commands to a running robot and follows its mode and motions.

    A context manager with a separate ROS context. It can be entered again, and several can be open at a time.

    Args:
        network: Whether the robot may run on another machine; loopback only otherwise.
        signer: Signs every text command; they are unsigned when None.
        namespace: Namespace of the robot; empty for none.

    Raises:
        PoiseError: The namespace is no valid name.

    Attributes:
        namespace: Namespace of the robot with a leading slash; empty for none.
        mode: Newest message on ``mode``; empty before the first.
        motions: Every status of a motion, in order.
        status: Newest status of the supervisor; None before the first.
        driver_state: Newest message on ``driver_state``; empty before the first.
        gaits: Every status of the gait planner, in order.
        commander: Active command source, from ``commands/active``; empty before the first message.
        factor: Ratio of robot time to real time, 0 while the robot time stands still; NaN before the first message.
        node: The node, for further topics and services inside the ``with`` block.
    """

    def __init__(self, *, network: bool = False, signer: Signer | None = None, namespace: str = "") -> None:
        self.namespace = absolute_namespace(namespace)
        self._network, self._signer = network, signer
        self.mode = ""
        self.driver_state = self.commander = ""
        self.gaits: list[GaitStatus] = []
        self.factor = math.nan
        self.motions: list[MotionStatus] = []
        self.status: SupervisorStatus | None = None
        self.node: Any
        self._stack = ExitStack()

    def __enter__(self) -> Client:
        self._entered = time.monotonic()
        joined = participant("poise_client", network=self._network, namespace=self.namespace)
        self.node, self._executor = self._stack.enter_context(joined)
        self._text = self.node.create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
        listen = self.node.create_subscription
        listen(String, topics.MODE, self._on_mode, LATCHED)
        listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        listen(String, topics.COMMANDER, self._on_commander, LATCHED)
        listen(Float64, topics.REAL_TIME_FACTOR, self._on_factor, LATCHED)
        subscribe_status(self.node, MotionStatus, topics.MOTION_STATUS, self.motions.append)
        subscribe_status(self.node, SupervisorStatus, topics.SUPERVISOR_STATUS, self._on_status, LATCHED)
        subscribe_status(self.node, GaitStatus, topics.GAIT_STATUS, self.gaits.append, LATCHED)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _on_mode(self, message: String) -> None:
        self.mode = message.data

    def _on_driver_state(self, message: String) -> None:
        self.driver_state = message.data

    def _on_commander(self, message: String) -> None:
        self.commander = message.data

    def _on_factor(self, message: Float64) -> None:
        self.factor = message.data

    @property
    def _walks(self) -> bool:
        return self.mode == Mode.WALK.value

    @property
    def gait(self) -> GaitStatus | None:
        """Newest status of the gait planner; None before the first."""
        return self.gaits[-1] if self.gaits else None

    @property
    def remarks(self) -> str:
        """``GaitStatus.remarks``; empty before the first status."""
        return self.gait.remarks if self.gait else ""

    def _on_status(self, status: SupervisorStatus) -> None:
        self.status = status
        self.mode = self.mode or status.mode.value  # the topic ``mode`` may be discovered later

    @property
    def holds(self) -> str:
        """Reasons that hold a walk; empty if there are none."""
        return "" if self.status is None else "; ".join(self.status.holds)

    @property
    def obstacle(self) -> str:
        """How an obstacle limits the walk; empty without a limit."""
        return "" if self.status is None else self.status.obstacle

    def status_is_current(self) -> bool:
        """Whether status and mode agree; either of them may be received first."""
        return self.status is not None and self.status.mode.value == self.mode

    @property
    def paused(self) -> str:
        """Remedy when the time of a simulated robot stands still; empty while it advances, and for a real robot."""
        pause = f'ros2 service call {self.namespace}/pause std_srvs/srv/SetBool "{{data: false}}"'
        text = f"the robot's time does not advance: poise reset, or {pause}, ends a pause of the simulation"
        return "" if self.factor or self.node.count_publishers(topics.START_STATUS) else text

    def robot(self, timeout: float = 5.0) -> str:
        """Profile name of the running robot, from the supervisor status; ``CommandError`` after ``timeout`` [s]."""
        self.expect(lambda: self.status is not None, timeout, "robot on", topics.SUPERVISOR_STATUS)
        assert self.status is not None
        return self.status.robot

    def expect(self, condition: Callable[[], bool], timeout: float, what: str, name: str) -> None:
        """Wait for ``what`` at a topic or service; after ``timeout`` [s] a ``CommandError`` names robots and a remedy.

        The wait is at most ``ROBOT_TIMEOUT`` if only other graphs run on this machine.
        """
        elsewhere = "" if self._network else graphs_elsewhere(self.namespace)
        timeout = min(timeout, ROBOT_TIMEOUT) if elsewhere else timeout
        if self.wait(condition, timeout):
            return
        holder = graph_holder(self.namespace)
        domain = os.environ.get("ROS_DOMAIN_ID") or "0"
        remedy = f"poise up ({holder}) is starting, or does not answer; use the remote controller of a real robot"
        if not holder:
            remedy = elsewhere or f"no robot is known in ROS domain {domain}, that of this terminal"
            remedy += "; if none is up, start it with: poise up"
        robots = namespaces_of_robots(self.node)
        if self.namespace in robots:
            up = "is up: poise status shows its state"
            remedy = self.paused or f"the robot {up if self.status else 'is starting, or does not answer: try again'}"
        elif robots:
            remedy = other_namespaces(robots)
        named = f"{self.namespace}/{name}" if self.namespace else name
        raise CommandError(f"no {what} {named} within {timeout:g} s: {remedy}")

    def spin(self, duration: float) -> None:
        """Serve callbacks for a time [s]."""
        self.wait(lambda: False, duration)

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Serve callbacks until a condition, checked after each, is met; returns whether within ``timeout`` [s]."""
        end = time.monotonic() + timeout
        while not condition():
            if (left := end - time.monotonic()) <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(SPIN, left))
        return True

    def _expect_subscriber(self, timeout: float = 5.0) -> None:
        self.expect(lambda: self._text.get_subscription_count() > 0, timeout, "subscriber on", topics.HUMANOID_COMMANDS)

    def send(self, text: str, timeout: float = 5.0) -> None:
        """Publish a text command; ``CommandError`` if signing fails or there is no subscriber in ``timeout`` [s]."""
        self._expect_subscriber(timeout)
        self.spin(self._entered + DISCOVERY - time.monotonic())  # also wait for subscribers of the user
        self._text.publish(String(data=signed(text, self._signer)))

    def command(self, text: str, timeout: float = 2.0) -> CommandReply:
        """Send a text command; returns the answer of the supervisor, or of the motion planner if it arrives in time.

        The reply to a velocity includes limits that the gait planner applies.

        The supervisor has ``timeout`` [s] to answer, the motion planner ``PLANNING`` [s]. Raises ``CommandError`` when
        no supervisor subscribes.
        """
        self._expect_subscriber()
        self.wait(lambda: self.status is not None, timeout)
        before = self.status
        self.motions.clear()
        self.send(text)

        def answered() -> bool:
            return before is not None and self.status is not None and self.status.answered > before.answered

        def motions() -> list[MotionStatus]:  # an ended one belongs to an earlier command
            return [each for each in self.motions if each.state not in (MotionState.DONE, MotionState.ENDED)]

        self.wait(answered, timeout)  # also after a motion status: the next command would get it
        status = self.status
        if answered() and status is not None and before is not None and status.refused > before.refused:
            return CommandReply(False, status.answer)
        if status is not None and status.motion:
            self.wait(lambda: bool(motions()), PLANNING)
        if found := motions():
            return CommandReply(found[0].state is not MotionState.REFUSED, f"{text[:32]}: {found[0]}")
        if not answered() or status is None:
            unanswered = f"no answer of the supervisor within {timeout:g} s; 'poise status' shows whether a robot runs"
            return CommandReply(False, unanswered)
        ends = text.strip().lower() in (STOP, Mode.STAND.value)
        if ends or not self.wait(lambda: self._walks and bool(self.remarks), LIMITING):
            return CommandReply(True, status.answer)
        return CommandReply(True, f"{status.answer}; {self.remarks}")

    def trigger(
        self, service: str, timeout: float = 5.0, answer_timeout: float | None = None, *, at_once: bool = False
    ) -> CommandReply:
        """Call a std_srvs/Trigger service; numbers in the answer become details of the reply.

        ``timeout`` [s] applies to the service and to its answer; ``answer_timeout`` replaces it for the answer.
        ``at_once`` is as for ``call``. Raises ``CommandError`` when the service is absent or does not answer.
        """
        answer = self.call(Trigger, service, Trigger.Request(), timeout, answer_timeout or timeout, at_once=at_once)
        return text_to_reply(bool(answer.success), str(answer.message))

    def await_trigger(self, service: str, timeout: float = 5.0) -> str:
        """Wait for a std_srvs/Trigger service; returns the profile name of the robot, if the supervisor is up.

        Raises ``CommandError`` when the service is absent for ``timeout`` [s].
        """
        client = self.node.create_client(Trigger, service)
        try:
            self.expect(client.service_is_ready, timeout, "service", service)
        finally:
            self.node.destroy_client(client)
        self.wait(lambda: self.status is not None, DISCOVERY)
        return "robot without supervisor" if self.status is None else self.status.robot

    def switch(self, service: str, on: bool) -> CommandReply:
        """Call a std_srvs/SetBool service; see ``trigger``."""
        answer = self.call(SetBool, service, SetBool.Request(data=on))
        return text_to_reply(bool(answer.success), str(answer.message))

    def set_parameter(self, node: str, name: str, value: bool | int | float | str) -> None:
        """Set a parameter of a node; ``CommandError`` without an answer or, with the reason, on refusal."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = self.call(SetParameters, f"{node}/set_parameters", request).results
        if not result.successful:
            raise CommandError(f"{node}: parameter {name} was not set: {result.reason}")

    def call(
        self,
        kind: type,
        service: str,
        request: Any,
        timeout: float = 5.0,
        answer_timeout: float = 5.0,
        *,
        at_once: bool = False,
    ) -> Any:
        """Call a service; ``CommandError`` after the timeout for the service or for its answer [s].

        ``at_once`` is for requests that may be repeated. The request is sent before the service has discovered this
        client. It is sent again if the answer was lost for that reason.
        """
        client = self.node.create_client(kind, service)
        try:
            self.expect(client.service_is_ready, timeout, "service", service)
            sent: list[Any] = [client.call_async(request)] if at_once else []

            def answered() -> bool:
                return any(future.done() for future in sent)

            if not self.wait(answered, SETTLE_TIME):
                sent.append(client.call_async(request))
            if not self.wait(answered, answer_timeout):
                raise CommandError(f"service {service} did not answer within {answer_timeout:.0f} s")
            return next(future.result() for future in sent if future.done())
        finally:
            self.node.destroy_client(client)


ROBOT_TIMEOUT = 2.0  #: Longest wait for a robot [s]
TOPICS_TIMEOUT = 3.0  #: Longest wait for further topics after the robot was found [s]


def overview(client: Client) -> dict[str, str]:
    """Status lines by name; ``CommandError`` when no robot is up."""
    start: list[StartStatus] = []
    subscribe_status(client.node, StartStatus, topics.START_STATUS, start.append, LATCHED)
    routes: list[RouteStatus] = []
    subscribe_status(client.node, RouteStatus, topics.ROUTE_STATUS, routes.append, LATCHED_EVENT)
    client.robot(ROBOT_TIMEOUT)

    def complete() -> bool:
        real = client.node.count_publishers(topics.START_STATUS) > 0
        gait = client.gait is not None or client.mode != Mode.WALK.value
        known = client.commander and client.driver_state and gait and not math.isnan(client.factor)
        return bool(known and (start or not real))

    client.wait(complete, TOPICS_TIMEOUT)
    if client.mode == Mode.WALK.value:
        client.spin(DISCOVERY)  # there may be no route
    status = client.status
    assert status is not None  # the wait above found a robot
    accepted = [each for each in routes if each.state is not RouteState.REFUSED]
    walks_to_goal = client.mode == Mode.WALK.value and accepted and accepted[-1].state is RouteState.RUNNING
    followed = ", the robot follows its goal" if walks_to_goal and client.commander == "none" else ""
    locks = "".join(f"; lock '{lock}' is closed" for lock in status.locks)
    return {
        "robot": f"{status.robot}, mode '{status.mode.value}'"
        + ("" if start else f", drivers '{client.driver_state or 'unknown'}'"),  # the start has details
        "faults": "; ".join((*status.faults, *status.holds)) or "none",
        "real-time factor": "unknown" if math.isnan(client.factor) else f"{client.factor:.2f}",
        "in command": f"{client.commander or 'unknown'}{followed}{locks}",
        **({"goal": str(accepted[-1])} if walks_to_goal else {}),
        **({"walk": client.remarks} if client.remarks else {}),
        **(start_lines(start[-1]) if start else {}),
        "next": client.paused or next_step(status, start[-1] if start else None),
    }


def start_lines(start: StartStatus) -> dict[str, str]:
    """Status lines of the start of a real robot, by name."""
    return {
        "start": start.state,
        "monitors": "; ".join((*start.holds, *start.warnings)) or "no warnings",
        **({"values": "; ".join(start.values)} if start.values else {}),
        **({"remote controller": start.remote} if start.remote else {}),
    }


def open_locks(status: SupervisorStatus) -> str:
    """How to open the closed locks; empty if none is closed."""
    return "; ".join(f"commands are locked out by '{x}': publish false on {topics.LOCKS}/{x}" for x in status.locks)


def next_step(status: SupervisorStatus, start: StartStatus | None = None) -> str:
    """Next action of the user, from the status of the supervisor and, optionally, of the start of a real robot."""
    if start is not None and start.waits_for:
        stopped = "emergency stop" in status.faults
        return start.waits_for + ("; standing then needs poise mode reset_faults" if stopped else "")
    moving = status.mode not in (Mode.OFF, Mode.DAMP)
    if status.fallen and not moving:
        return GET_UP
    if status.faults:
        return "poise mode reset_faults" + ("" if moving else "; poise mode stand")
    if start is not None and start.holds:
        return f"no motion or walk while this lasts: {'; '.join(start.holds)}"
    if moving and status.locks:
        return open_locks(status)
    if status.mode is Mode.STAND:
        return f"poise send wave; poise walk {0.3 if start is None else 0.2} 0 0; poise teleop"
    if moving:
        return "poise send stop" + ("" if start is None else "; in an emergency poise start damp")
    return f"wait, or correct: {'; '.join(status.preflight)}" if status.preflight else "poise mode stand"
