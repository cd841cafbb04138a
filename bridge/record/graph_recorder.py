"""Records the topics of the running graph, or only the IMU."""

import json
import os
import time
from array import array
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import String

from bridge.record.mcap_log import DESCRIPTION, DIAGNOSTICS, ROBOT, TYPES, McapLog
from bridge.record.run_file import missing
from bridge.ros.environment import namespaces_of_robots, other_namespaces, participant
from models.errors import CommandError, MessageError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.imu import ImuSample, OrientedImuCodec
from models.nodes.messages import decode
from models.nodes.qos import SENSOR_QUEUE, keep_last
from models.nodes.spin import Stop, make_executor

LOOK = 0.1  #: Polling period for new topics [s]
PATIENCE = 2.0  #: Time without a robot until a message is printed [s]
SILENCE = 10.0  #: Time without any message after which the robot counts as stopped [s]
DEPTH = 5000  #: Queue depth of a topic [messages]: five seconds at 1 kHz
NICENESS = -10  #: Niceness, if permitted; real-time priority is left to the bridge and the control process
#: Topics logged at their stamp; the others are logged at the stamp of the newest joint sample
STAMPED = frozenset(
    {
        *(topics.JOINT_STATES, topics.IMU_RAW, *topics.FOOT_WRENCHES, topics.JOINT_SETPOINTS),
        *(topics.ODOM, topics.GROUND_TRUTH, topics.IMU_DATA, topics.EXTERNAL_WRENCH),
    }
)


class GraphRecorder:
    """Records every known topic that has a publisher to ``log``, with the offered QoS.

    Log times are times of the robot; messages before the first stamp are buffered until it arrives. ``robot`` is the
    profile name, empty before it is published. ``left_out`` are topics that cannot be recorded here, with the reason.
    """

    def __init__(self, log: McapLog) -> None:
        self.robot = ""
        self.left_out: dict[str, str] = {}
        self._log = log
        self._stamps = array("q")
        self._waiting: list[tuple[str, bytes]] = []
        self._now = 0
        self.received = 0
        self._known: set[str] = set()

    @property
    def duration(self) -> float:
        """Time from the first joint sample to the newest [s]."""
        return (self._stamps[-1] - self._stamps[0]) / NANOSECONDS if self._stamps else 0.0

    @property
    def sampled(self) -> bool:
        """Whether a joint sample has arrived; without one, the recording has no time."""
        return bool(self._stamps)

    @property
    def lost(self) -> int:
        """Number of missing joint samples."""
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
        """Record for a time on the robot's clock [s], until a signal sets ``stop``, or until the robot is silent.

        With ``network`` the robot may run on another machine. The file omits the namespace, so that it replays like
        the file of a robot without one. ``say`` is called with one sentence about each event.
        """
        with suppress(OSError):  # not permitted: default niceness
            os.setpriority(os.PRIO_PROCESS, 0, NICENESS)  # threads that start later inherit it
        joined = participant("poise_record", network=network, namespace=namespace, make=make_executor)
        try:
            with joined as (node, executor):
                self._run(node, executor, seconds, stop, say)
        finally:
            self._write_waiting()
            self._log.describe(DESCRIPTION, {ROBOT: self.robot})

    def _run(self, node: Any, executor: Any, seconds: float | None, stop: Stop, say: Callable[[str], object]) -> None:
        begin = since = now = time.monotonic()
        before, waited, due = 0, False, 0.0
        while not stop.requested and (seconds is None or self.duration < seconds):
            if now >= due:
                due = now + LOOK
                self._look(node)
            executor.spin_once(timeout_sec=LOOK)  # serves one message, not all pending ones
            now = time.monotonic()
            if self.received != before:
                before, since = self.received, now
            elif self.received and now - since > SILENCE:
                say(f"no message of the robot for {SILENCE:.0f} s: the recording ends")
                return
            if not self._now and not waited and now - begin > PATIENCE:
                waited = True
                say(f"waiting for the robot ({_robots_up(node) or 'poise up'}); Ctrl-C ends")

    def _look(self, node: Any) -> None:
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
        """Subscribe reliable and transient local if every publisher offers it."""
        reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
        latched = all(offer.durability == DurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
        qos = keep_last(DEPTH, reliable=reliable, latched=latched)
        package, _, short = kind.partition("/msg/")
        message = getattr(import_module(f"{package}.msg"), short)
        written = f"/{topic.removeprefix('/')}"
        self._log.announce(written, kind, latched=latched)
        node.create_subscription(message, name, lambda data: self.take(topic, written, bytes(data)), qos, raw=True)

    def take(self, topic: str, name: str, data: bytes) -> None:
        """Write a message under the name of its topic in the file, or buffer it until the robot's time is known."""
        self.received += 1
        stamp = stamp_of(data, logged=True) if topic in STAMPED else 0
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


def _robots_up(node: Any) -> str:
    """Namespaces of running robots, with the remedy; empty if there is none, or one in the namespace of the node."""
    robots = namespaces_of_robots(node)
    return other_namespaces(robots) if robots and node.get_namespace().rstrip("/") not in robots else ""


def _robot(topic: str, data: bytes) -> str:
    """Profile name of the robot in a message; empty without one."""
    if topic == DIAGNOSTICS:
        named = [status.hardware_id for status in decode(data, DiagnosticArray).status]
        return str(next(filter(None, named), ""))
    entries = json.loads(decode(data, String).data)
    return next((str(entry[1]["robot"]) for entry in entries["before"] if entry[0] == "start"), "")


SPIN = 0.1  #: Longest wait for a callback [s]


class ImuListener:
    """Calls ``take`` with stamp [ns], sample and message; ``refused`` counts malformed and old messages."""

    def __init__(self, take: Callable[[int, ImuSample, bytes], None]) -> None:
        self._take, self._codec = take, OrientedImuCodec(topics.IMU_FRAME)
        self.first: int | None = None
        self.last = self.count = self.refused = 0

    @property
    def duration(self) -> float:
        """Time from the first sample to the newest [s]."""
        return 0.0 if self.first is None else (self.last - self.first) / NANOSECONDS

    def on_message(self, data: bytes) -> None:
        """Decode a message and pass it to ``take``."""
        try:
            stamp, sample = self._codec.decode(data)
        except MessageError:
            self.refused += 1
            return
        if self.first is not None and stamp <= self.last:
            self.refused += 1
            return
        self.first = stamp if self.first is None else self.first
        self.last = stamp
        self.count += 1
        self._take(stamp, sample, bytes(data))

    def listen(
        self, seconds: float | None, stop: Stop, *, network: bool = False, namespace: str = "", silence: float = 5.0
    ) -> None:
        """Pass on samples for a time by their stamps [s], or until a signal; a sample is never interrupted.

        The signal sets ``stop``; with ``network`` the robot may run on another machine. Raises ``CommandError`` when no
        sample arrives within ``silence`` [s].
        """
        with participant("poise_imu_log", network=network, namespace=namespace) as (node, executor):
            node.create_subscription(Imu, topics.IMU_DATA, self.on_message, SENSOR_QUEUE, raw=True)
            received, since = self.count, time.monotonic()
            while not stop.requested and (seconds is None or self.duration < seconds):
                executor.spin_once(timeout_sec=SPIN)
                if self.count != received:
                    received, since = self.count, time.monotonic()
                elif time.monotonic() - since > silence:
                    remedy = _robots_up(node) or "is the robot up? (poise up)"
                    raise CommandError(f"no message on {topics.IMU_DATA} for {silence:.0f} s: {remedy}")
