"""Quality of service of every topic of the graph, and the detection of endpoints that do not match."""

import time
from typing import Any, NamedTuple

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
    qos_policy_name_from_kind,
)


def keep_last(depth: int, *, reliable: bool, latched: bool = False, deadline_s: float | None = None) -> QoSProfile:
    """Profile of a queue of ``depth`` messages; DDS watches the deadline [s], disabled when None."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        **({} if deadline_s is None else {"deadline": Duration(nanoseconds=round(deadline_s * 1e9))}),
    )


#: Publishers of sensors and states: reliable, so that a subscriber with default QoS matches. With keep last a publisher
#: never waits for a subscriber: the oldest message makes room, acknowledged or not
STATE = keep_last(10, reliable=True)
#: Subscribers of the graph to sensors and states: only the newest sample matters
SENSOR = keep_last(1, reliable=False)
#: Sensors for a subscriber that counts or logs: deep enough for a busy one
SENSOR_QUEUE = keep_last(100, reliable=False)
#: ``/robot_description``, ``/mode``: late subscribers get the last value
LATCHED = keep_last(1, reliable=True, latched=True)
#: ``/refusals``: late subscribers get the last ones of each node
REFUSALS = keep_last(10, reliable=True, latched=True)
#: Requests and replies: none may be lost
EVENT = keep_last(10, reliable=True)
#: Joint commands without an offered or requested deadline, for commanders slower than the controller
COMMAND = keep_last(1, reliable=True)


def sensor(*, lockstep: bool, waits: bool) -> QoSProfile:
    """Profile of a subscriber to sensors: the newest; where the plant waits every sample, in lockstep none lost."""
    return STATE if lockstep else SENSOR_QUEUE if waits else SENSOR


def command(deadline_s: float | None = None) -> QoSProfile:
    """Joint commands: reliable, newest only, with this offered deadline [s], none when None."""
    return keep_last(1, reliable=True, deadline_s=deadline_s)


#: Time for which a mismatch counts without the graph: the event may precede the discovery of the other end [s]
SETTLE_TIME = 1.0
INCOMPATIBLE_QOS = "incompatible QoS"  #: First words of the key in diagnostics; the topic follows
PUBLISHER, SUBSCRIBER = "publisher", "subscriber"


class Endpoint(NamedTuple):
    """One end of a topic, by the name that the node uses; ``other`` is ``PUBLISHER`` or ``SUBSCRIBER``."""

    topic: str
    other: str


class Mismatch(NamedTuple):
    """Last event: policy such as ``RELIABILITY``, profile of the node's end, and monotonic time [s]."""

    policy: str
    qos: QoSProfile
    seen: float


class QosWatch:
    """Records mismatches from the middleware's events, and asks the graph whether the other end still exists.

    Events come at discovery, never in a tick; without a mismatch ``look`` costs nothing. No event reports that the
    other end has gone, so ``look`` compares profiles; a killed one goes when its lease ends, up to 20 s later.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._found: dict[Endpoint, Mismatch] = {}

    def publisher(self, topic: str, qos: QoSProfile) -> PublisherEventCallbacks:
        """Callbacks for a publisher of the node."""
        end = Endpoint(topic, SUBSCRIBER)
        return PublisherEventCallbacks(incompatible_qos=lambda event: self._note(end, qos, event))

    def subscription(self, topic: str, qos: QoSProfile) -> SubscriptionEventCallbacks:
        """Callbacks for a subscription of the node."""
        end = Endpoint(topic, PUBLISHER)
        return SubscriptionEventCallbacks(incompatible_qos=lambda event: self._note(end, qos, event))

    def look(self) -> None:
        """Drop mismatches whose other ends are gone. Asks the graph, about 0.1 ms for each: never in a tick."""
        now = time.monotonic()
        for end, mismatch in list(self._found.items()):
            if now - mismatch.seen >= SETTLE_TIME and not self._stands(end, mismatch.qos):
                del self._found[end]
                self._node.get_logger().info(f"'{end.topic}': no {end.other} with incompatible QoS any more")

    def forget(self, topic: str) -> None:
        """Drop the mismatches of a topic that the node gives up."""
        for other in (PUBLISHER, SUBSCRIBER):
            self._found.pop(Endpoint(topic, other), None)

    def values(self) -> dict[str, str]:
        """Items for the diagnostics; none when all agree."""
        return {
            f"{INCOMPATIBLE_QOS} {end.topic}": f"{end.other}: {mismatch.policy}"
            for end, mismatch in self._found.items()
        }

    def mismatches(self) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        """Topic, other end and policy of each mismatch."""
        found = [(end.topic, end.other, mismatch.policy) for end, mismatch in self._found.items()]
        topics_, ends, policies = zip(*found, strict=True) if found else ((), (), ())
        return topics_, ends, policies

    def _note(self, end: Endpoint, qos: QoSProfile, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        if end not in self._found:
            self._node.get_logger().warning(f"'{end.topic}' has a {end.other} with incompatible QoS: {policy}")
        self._found[end] = Mismatch(policy, qos, time.monotonic())

    def _stands(self, end: Endpoint, qos: QoSProfile) -> bool:
        """Whether an incompatible endpoint still exists at the other end."""
        if end.other == PUBLISHER:
            offered = self._node.get_publishers_info_by_topic(end.topic)
            pairs = [(info.qos_profile, qos) for info in offered]
        else:
            requested = self._node.get_subscriptions_info_by_topic(end.topic)
            pairs = [(qos, info.qos_profile) for info in requested]
        return any(qos_check_compatible(*pair)[0] == QoSCompatibility.ERROR for pair in pairs)
