"""A short-lived participant of the graph, for commands to a running robot."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from bridge.ros.environment import participant
from bridge.ros.processes import absolute_namespace
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.calibration_text import text_to_reply
from models.nodes.qos import EVENT, LATCHED
from models.nodes.status import subscribe_status
from models.status import MotionState, MotionStatus, SupervisorStatus
from models.types import CommandReply

if TYPE_CHECKING:
    from controllers.commands.command_signature import Signer

SPIN = 0.01  #: Longest wait for a callback between two checks of a condition [s]


STOP = "stop"  #: Command that every source may send; never signed, so that no signature can be refused


def signed(text: str, signer: Signer | None) -> str:
    """The text to send; ``signer`` None leaves it unsigned. ``CommandError`` when it cannot be signed."""
    return text if signer is None or text.strip().lower() == STOP else signer.sign(text)


class Client:
    """Sends commands to a running robot and follows its mode and motions.

    A context manager with a separate ROS context: it can be opened again and beside others.

    Args:
        network: Whether the robot may run on another machine; loopback only otherwise.
        signer: Signs every text command; None sends them unsigned.
        namespace: Of the robot; empty for none.

    Raises:
        PoiseError: The namespace is no valid name.

    Attributes:
        namespace: Of the robot, with its leading slash; empty for none.
        mode: Newest word on ``mode``; empty before the first.
        motions: Every status of a motion, in order.
        status: Newest status of the supervisor; None before the first.
        driver_state: Newest word on ``driver_state``; empty before the first.
        node: The node, for further topics and services inside the ``with`` block.
    """

    def __init__(self, *, network: bool = False, signer: Signer | None = None, namespace: str = "") -> None:
        self.namespace = absolute_namespace(namespace)
        self._network, self._signer = network, signer
        self.mode = ""
        self.driver_state = ""
        self.motions: list[MotionStatus] = []
        self.status: SupervisorStatus | None = None
        self.node: Any
        self._stack = ExitStack()

    def __enter__(self) -> Client:
        joined = participant("poise_client", network=self._network, namespace=self.namespace)
        self.node, self._executor = self._stack.enter_context(joined)
        self._text = self.node.create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
        listen = self.node.create_subscription
        listen(String, topics.MODE, self._on_mode, LATCHED)
        listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        subscribe_status(self.node, MotionStatus, topics.MOTION_STATUS, self.motions.append)
        subscribe_status(self.node, SupervisorStatus, topics.SUPERVISOR_STATUS, self._on_status, LATCHED)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _on_mode(self, message: String) -> None:
        self.mode = message.data

    def _on_driver_state(self, message: String) -> None:
        self.driver_state = message.data

    def _on_status(self, status: SupervisorStatus) -> None:
        self.status = status
        self.mode = self.mode or status.mode.value  # ``mode`` itself may be discovered later

    def _named(self, name: str) -> str:
        """A topic or service without the namespace, for messages to the user."""
        return f"{self.namespace}/{name}" if self.namespace else name

    def robot(self, timeout: float = 10.0) -> str:
        """Profile name of the running robot, from its supervisor's status; ``PoiseError`` after ``timeout`` [s]."""
        if not self.wait(lambda: self.status is not None, timeout) or self.status is None:
            name = self._named(topics.SUPERVISOR_STATUS)
            raise PoiseError(f"no robot on {name} within {timeout:.0f} s: is one up? start it with: poise up")
        return self.status.robot

    def spin(self, duration: float) -> None:
        """Serve callbacks for a time [s]."""
        self.wait(lambda: False, duration)

    def wait(
        self, condition: Callable[[], bool], timeout: float, meanwhile: Callable[[], object] | None = None
    ) -> bool:
        """Serve callbacks until a condition, checked after each, is met; returns whether it was within ``timeout`` [s].

        ``meanwhile`` is called about every ``SPIN`` seconds.
        """
        end = time.monotonic() + timeout
        while not condition():
            left = end - time.monotonic()
            if left <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(SPIN, left))
            if meanwhile is not None:
                meanwhile()
        return True

    def send(self, text: str, timeout: float = 5.0) -> None:
        """Publish a text command; ``CommandError`` without a subscriber in ``timeout`` [s], or if signing fails."""
        if not self.wait(lambda: self._text.get_subscription_count() > 0, timeout):
            name = self._named(topics.HUMANOID_COMMANDS)
            raise CommandError(f"no subscriber on {name}: is the robot up? start it with: poise up")
        self._text.publish(String(data=signed(text, self._signer)))

    def command(self, text: str, timeout: float = 2.0) -> CommandReply:
        """Send a text command and wait for its effect.

        A refusal appears in the status of the supervisor, a motion on ``motion/status``; a command with neither, such
        as stop, counts as accepted after ``timeout`` [s], which is also the longest wait for the supervisor's status
        before sending. Raises ``CommandError`` when no supervisor subscribes.
        """
        self.wait(lambda: self.status is not None, timeout)
        before = self.status

        def refused() -> bool:
            return before is not None and self.status is not None and self.status.refused > before.refused

        self.motions.clear()
        self.send(text)
        self.wait(lambda: bool(self.motions) or refused(), timeout)
        if self.motions:
            motion = self.motions[0]
            return CommandReply(motion.state is not MotionState.REFUSED, f"{text[:32]}: {motion}")
        if refused() and self.status is not None:
            return CommandReply(False, self.status.refusal)
        return CommandReply(True, f"sent; mode {self.mode or 'unknown'}")

    def trigger(self, service: str, timeout: float = 5.0, answer_timeout: float | None = None) -> CommandReply:
        """Call a std_srvs/Trigger service; numbers in its answer become details.

        ``timeout`` is for the service and for its answer, each [s]; ``answer_timeout`` replaces the latter. Raises
        ``CommandError`` when the service is absent or does not answer.
        """
        answer = self.call(Trigger, service, Trigger.Request(), timeout, answer_timeout or timeout)
        return text_to_reply(bool(answer.success), str(answer.message))

    def switch(self, service: str, on: bool, timeout: float = 10.0) -> CommandReply:
        """Call a std_srvs/SetBool service; otherwise as ``trigger``."""
        answer = self.call(SetBool, service, SetBool.Request(data=on), timeout, timeout)
        return text_to_reply(bool(answer.success), str(answer.message))

    def call(self, kind: type, service: str, request: Any, timeout: float = 5.0, answer_timeout: float = 5.0) -> Any:
        """Call a service within the timeouts for service and answer [s]; otherwise ``CommandError``."""
        client = self.node.create_client(kind, service)
        try:
            if not self.wait(client.service_is_ready, timeout):
                raise CommandError(f"service {self._named(service)} is absent: is the robot up? (poise up)")
            future: Any = client.call_async(request)
            if not self.wait(future.done, answer_timeout):
                raise CommandError(f"service {service} did not answer within {answer_timeout:.0f} s")
            return future.result()
        finally:
            self.node.destroy_client(client)
