"""A short-lived participant of the graph: what the command line needs to talk to a running robot."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from bridge.ros.environment import join_graph
from bridge.ros.processes import absolute_namespace, in_namespace
from controllers.command_signature import Signer
from models.errors import CommandError, PoiseError
from models.nodes import topics
from models.nodes.calibration_text import text_to_reply
from models.nodes.qos import EVENT, LATCHED
from models.nodes.spin import log_arguments
from models.types import CommandReply

SPIN = 0.01
"""Longest wait for a callback between two looks at a condition [s]."""


STOP = "stop"
"""The word that everybody may say, and that nothing may hinder: it is never signed, so that no signature is refused."""


def signed(text: str, signer: Signer | None) -> str:
    """A word as it is sent.

    Args:
        text: The word.
        signer: Signs it; None to send it as it is.

    Raises:
        CommandError: It cannot be signed.
    """
    return text if signer is None or text.strip().lower() == STOP else signer.sign(text)


class Client:
    """Sends commands to a running robot and follows its mode and motions.

    A context manager; its ROS context is its own, so it can be opened again and beside others.

    Args:
        network: Whether the robot may run on another machine; loopback only otherwise.
        signer: Signs every text command; None sends them as they are.
        namespace: Of the robot; empty for none.

    Raises:
        PoiseError: The namespace is no valid name.

    Attributes:
        namespace: Of the robot, with its leading slash; empty for none.
        mode: Newest word on ``mode``; empty before the first.
        motion_states: Every word on ``motion/state`` and every refusal on ``motion/plan_state``, in order.
        driver_state: Newest word on ``driver_state``; empty before the first.
        context: The ROS context.
    """

    def __init__(self, *, network: bool = False, signer: Signer | None = None, namespace: str = "") -> None:
        self.namespace = absolute_namespace(namespace)
        self._network, self._signer = network, signer
        self.mode = ""
        self.driver_state = ""
        self.motion_states: list[str] = []
        self._refusals: int | None = None
        self._last_refusal = ""
        self._robot = ""
        self.context = Context()

    def __enter__(self) -> Client:
        join_graph(network=self._network)
        rclpy.init(
            args=[*sys.argv, *log_arguments()], context=self.context, signal_handler_options=SignalHandlerOptions.NO
        )
        self._node = Node("poise_client", context=self.context, **in_namespace(self.namespace))
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self._node)
        self._text = self._node.create_publisher(String, topics.HUMANOID_COMMANDS, EVENT)
        listen = self._node.create_subscription
        listen(String, topics.MODE, self._on_mode, LATCHED)
        listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        listen(String, topics.MOTION_STATE, self._on_motion, EVENT)
        listen(String, topics.MOTION_PLAN_STATE, self._on_plan, EVENT)
        listen(DiagnosticArray, "/diagnostics", self._on_diagnostics, EVENT)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.remove_node(self._node)
        self._executor.shutdown()
        self._node.destroy_node()
        try_shutdown(context=self.context)

    def _on_mode(self, message: String) -> None:
        self.mode = message.data

    def _on_driver_state(self, message: String) -> None:
        self.driver_state = message.data

    def _on_motion(self, message: String) -> None:
        self.motion_states.append(message.data)

    def _on_plan(self, message: String) -> None:
        if message.data.startswith(topics.MOTION_REFUSED):
            self.motion_states.append(message.data)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        """Note how many text commands the supervisor has refused."""
        for status in message.status:
            if status.name.endswith("/supervisor"):
                self._robot = str(status.hardware_id)
                values = {item.key: item.value for item in status.values}
                self._refusals = int(values.get(f"refused {topics.HUMANOID_COMMANDS}", "0"))
                self._last_refusal = values.get("last refusal", "refused")

    def _named(self, name: str) -> str:
        """A topic or service as the user knows it."""
        return f"{self.namespace}/{name}" if self.namespace else name

    def publisher(self, kind: type, topic: str, qos: Any) -> Any:
        """Publisher until the client leaves; see ``Node.create_publisher``."""
        return self._node.create_publisher(kind, topic, qos)

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None], qos: Any) -> None:
        """Subscription until the client leaves; see ``Node.create_subscription``."""
        self._node.create_subscription(kind, topic, callback, qos)

    def service(self, kind: type, name: str) -> Any:
        """Client of a service until this one leaves; see ``Node.create_client``."""
        return self._node.create_client(kind, name)

    def parameters_of(self, node: str) -> Any:
        """Parameters of another node, until this one leaves; see ``rclpy.parameter_client.AsyncParameterClient``."""
        return AsyncParameterClient(self._node, node)

    def robot(self, timeout: float = 10.0) -> str:
        """Name of the profile of the running robot, as its supervisor's diagnostics carry it.

        Raises:
            PoiseError: Nobody says it within a time [s].
        """
        if not self.wait(lambda: bool(self._robot), timeout):
            raise PoiseError(f"no robot on /diagnostics within {timeout:.0f} s: is one up? start it with: poise up")
        return self._robot

    def spin(self, duration: float) -> None:
        """Serve callbacks for a time [s]."""
        self.wait(lambda: False, duration)

    def wait(
        self, condition: Callable[[], bool], timeout: float, meanwhile: Callable[[], object] | None = None
    ) -> bool:
        """Serve callbacks until a condition holds.

        Args:
            condition: Looked at after every callback.
            timeout: Longest wait [s].
            meanwhile: Called about every ``SPIN`` seconds.

        Returns:
            Whether it came to hold.
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
        """Publish a text command once a supervisor listens.

        Raises:
            CommandError: Nobody listens, or the text cannot be signed.
        """
        if not self.wait(lambda: self._text.get_subscription_count() > 0, timeout):
            name = self._named(topics.HUMANOID_COMMANDS)
            raise CommandError(f"nobody listens on {name}: is the robot up? start it with: poise up")
        self._text.publish(String(data=signed(text, self._signer)))

    def command(self, text: str, timeout: float = 2.0) -> CommandReply:
        """Send a text command and look at what the supervisor says about it.

        The supervisor answers on ``/diagnostics`` (refusals) and ``motion/state``; a command that neither refuses nor
        starts a motion, such as stop, counts as carried out when ``timeout`` has passed.

        Args:
            text: The command.
            timeout: Longest wait for the supervisor's diagnostics before and after sending [s].

        Raises:
            CommandError: Nobody listens.
        """
        known = self.wait(lambda: self._refusals is not None, timeout)
        before = self._refusals or 0
        self.motion_states.clear()
        self.send(text)
        self.wait(lambda: bool(self.motion_states) or (known and (self._refusals or 0) > before), timeout)
        if self.motion_states:
            word = self.motion_states[0]
            return CommandReply(not word.startswith(topics.MOTION_REFUSED), f"{text[:32]}: {word}")
        if known and (self._refusals or 0) > before:
            return CommandReply(False, self._last_refusal)
        return CommandReply(True, f"sent; mode {self.mode or 'unknown'}")

    def trigger(self, service: str, timeout: float = 5.0, answer_timeout: float | None = None) -> CommandReply:
        """Call a service of type std_srvs/Trigger.

        Args:
            service: Its name.
            timeout: Longest wait for the service and for its answer, each [s].
            answer_timeout: Longest wait for the answer, where it takes longer [s].

        Returns:
            Its answer; numbers in it become details.

        Raises:
            CommandError: The service is absent or does not answer.
        """
        answer = self.call(Trigger, service, Trigger.Request(), timeout, answer_timeout or timeout)
        return text_to_reply(bool(answer.success), str(answer.message))

    def switch(self, service: str, on: bool, timeout: float = 10.0) -> CommandReply:
        """Call a service of type std_srvs/SetBool; otherwise as ``trigger``."""
        answer = self.call(SetBool, service, SetBool.Request(data=on), timeout, timeout)
        return text_to_reply(bool(answer.success), str(answer.message))

    def call(self, kind: type, service: str, request: Any, timeout: float = 5.0, answer_timeout: float = 5.0) -> Any:
        """Call a service of any type; returns its response.

        Args:
            kind: Type of the service.
            service: Its name.
            request: What to ask.
            timeout: Longest wait for the service [s].
            answer_timeout: Longest wait for its answer [s].

        Raises:
            CommandError: The service is absent or does not answer.
        """
        client = self._node.create_client(kind, service)
        try:
            if not self.wait(client.service_is_ready, timeout):
                raise CommandError(f"service {self._named(service)} is absent: is the robot up? (poise up)")
            future: Any = client.call_async(request)
            if not self.wait(future.done, answer_timeout):
                raise CommandError(f"service {service} did not answer within {answer_timeout:.0f} s")
            return future.result()
        finally:
            self._node.destroy_client(client)
