"""Records the topics of the running graph as they come."""

from __future__ import annotations

import json
import os
import sys
import time
from array import array
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from std_msgs.msg import String

from bridge.mcap_log import McapLog
from bridge.ros.environment import join_graph, roomy_profile
from bridge.ros.processes import absolute_namespace, in_namespace
from bridge.run_file import missing
from bridge.run_topics import DESCRIPTION, DIAGNOSTICS, ROBOT, TYPES
from models.errors import MessageError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.message_text import message_text
from models.nodes.messages import decode
from models.nodes.spin import Stop, log_arguments, make_executor
from models.nodes.tf_type import DEFINITION, TYPE_NAME, tf_message_type

LOOK = 0.1
"""Time between two looks for new topics [s]."""

PATIENCE = 2.0
"""Time without any robot after which it is said that there is none yet [s]."""

SILENCE = 10.0
"""Time without any message after which the robot has gone [s]."""

DEPTH = 5000
"""Messages of a topic that may wait: five seconds at 1 kHz."""

NICENESS = -10
"""Of the recorder, where permitted: before other programs. No real-time priority: bridge and control need all there is
of it, and the recorder must cost the robot nothing."""

RECEIVE_BUFFER = 8_000_000
"""Wanted for each socket, as far as ``net.core.rmem_max`` goes [bytes]: messages wait there while others compute."""

STAMPED = frozenset(
    {
        *(topics.JOINT_STATES, topics.IMU_RAW, *topics.FOOT_WRENCHES, topics.JOINT_COMMAND),
        *(topics.ODOM, topics.GROUND_TRUTH, topics.IMU_DATA, topics.EXTERNAL_WRENCH),
    }
)
"""Topics whose own stamp is the time of the log; of the others it is that of the newest joints."""


class GraphRecorder:
    """Subscribes to every topic that somebody publishes, with the QoS that it is offered with, and writes it down.

    The time of the log is the robot's: what comes before its first stamp waits for it.

    Args:
        log: Where the messages go.

    Attributes:
        robot: Name of the robot's profile; empty until the robot has said it.
        heard: Messages so far.
        left_out: Topics that cannot be recorded here, and why.
    """

    def __init__(self, log: McapLog) -> None:
        self.robot = ""
        self.left_out: dict[str, str] = {}
        self._log = log
        self._stamps = array("q")
        self._waiting: list[tuple[str, bytes]] = []
        self._now = 0
        self.heard = 0
        self._known: set[str] = set()

    @property
    def duration(self) -> float:
        """Time from the first joint sample to the newest [s]."""
        return (self._stamps[-1] - self._stamps[0]) / NANOSECONDS if self._stamps else 0.0

    @property
    def lost(self) -> int:
        """Joint samples that are missing."""
        return missing(self._stamps)

    def record(
        self,
        seconds: float | None,
        stop: Stop,
        *,
        network: bool = False,
        namespace: str = "",
        say: Callable[[str], object],
    ) -> None:
        """Record for a time on the robot's clock, or until a signal or the end of the robot.

        Args:
            seconds: For how long [s]; None for as long as it lasts.
            stop: Set by the signal.
            network: Whether the robot may run on another machine.
            namespace: Of the robot, which the file leaves out: it can be replayed as that of a robot without.
            say: Takes a sentence about what goes on.
        """
        join_graph(network=network)
        with suppress(OSError):  # not permitted: as any other process
            os.setpriority(os.PRIO_PROCESS, 0, NICENESS)  # before there are threads, which inherit it
        context = Context()
        arguments = [*sys.argv[:1], *log_arguments()]
        with roomy_profile(RECEIVE_BUFFER):
            rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
            node = Node("poise_record", context=context, **in_namespace(absolute_namespace(namespace)))
        executor = make_executor(context)
        try:
            executor.add_node(node)
            self._run(node, executor, seconds, stop, say)
        finally:
            executor.shutdown()
            node.destroy_node()
            try_shutdown(context=context)
            self._write_waiting()
            self._log.describe(DESCRIPTION, {ROBOT: self.robot})

    def _run(self, node: Any, executor: Any, seconds: float | None, stop: Stop, say: Callable[[str], object]) -> None:
        """Serve messages until the end, and look for new topics now and then."""
        begin = since = now = time.monotonic()
        before, waited, due = 0, False, 0.0
        while not stop.requested and (seconds is None or self.duration < seconds):
            if now >= due:
                due = now + LOOK
                self._look(node)
            executor.spin_once(timeout_sec=LOOK)  # serves one message, not all that wait
            now = time.monotonic()
            if self.heard != before:
                before, since = self.heard, now
            elif self.heard and now - since > SILENCE:
                say(f"the robot is silent for {SILENCE:.0f} s: the recording ends")
                return
            elif not self.heard and not waited and now - begin > PATIENCE:
                waited = True
                say("waiting for the robot (poise up); Ctrl-C ends")

    def _look(self, node: Any) -> None:
        """Subscribe to what has come up since the last look."""
        present = {name for name, _ in node.get_topic_names_and_types()}
        for topic, kind in TYPES.items():
            name = node.resolve_topic_name(topic)
            if topic in self._known or name not in present:
                continue
            offers = [info.qos_profile for info in node.get_publishers_info_by_topic(name)]
            if not offers:
                continue
            self._known.add(topic)
            try:
                self._subscribe(node, topic, name, kind, offers)
            except (MessageError, ImportError) as error:
                self.left_out[name] = str(error)

    def _subscribe(self, node: Any, topic: str, name: str, kind: str, offers: list[Any]) -> None:
        """Listen to a topic: reliably, and for what is latched, where every publisher offers that."""
        reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
        latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST,
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        if kind == TYPE_NAME:
            message = tf_message_type()
            text = DEFINITION + message_text("geometry_msgs/msg/TransformStamped", header=True)
        else:
            package, _, short = kind.partition("/msg/")
            message, text = getattr(import_module(f"{package}.msg"), short), ""
        written = f"/{topic.removeprefix('/')}"
        self._log.announce(written, kind, text)
        node.create_subscription(message, name, lambda data: self.take(topic, written, bytes(data)), qos, raw=True)

    def take(self, topic: str, name: str, data: bytes) -> None:
        """Write a message down, or keep it until the robot's time is known.

        Args:
            topic: Its name in ``TYPES``.
            name: Its name in the file.
            data: The message.
        """
        self.heard += 1
        stamp = stamp_of(data) if topic in STAMPED else 0
        if topic == topics.JOINT_STATES:
            self._stamps.append(stamp)
            self._now = max(self._now, stamp)
        if not self.robot and topic in (DIAGNOSTICS, topics.APPLIED):
            self.robot = _robot(topic, data)
        if not self._now:
            self._waiting.append((name, data))
            return
        if self._waiting:
            self._write_waiting()
        self._log.add(name, data, stamp or self._now)

    def _write_waiting(self) -> None:
        for name, data in self._waiting:
            self._log.add(name, data, self._now)
        self._waiting.clear()


def _robot(topic: str, data: bytes) -> str:
    """Name of the robot's profile in a message; empty where it is not said."""
    if topic == DIAGNOSTICS:
        named = [status.hardware_id for status in decode(data, DiagnosticArray).status]
        return str(next(filter(None, named), ""))
    entries = json.loads(decode(data, String).data)
    return next((str(entry[1]["robot"]) for entry in entries["before"] if entry[0] == "start"), "")
