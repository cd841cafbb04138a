"""Quality of service of all topics of the graph, and detection of incompatible endpoints."""

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
    """Profile with a queue of ``depth`` messages; DDS monitors the deadline [s], disabled when None."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        **({} if deadline_s is None else {"deadline": Duration(nanoseconds=round(deadline_s * 1e9))}),
    )


#: Publishers of sensors and states: reliable, so that a subscriber with default QoS matches. With keep last a publisher
#: never waits for a subscriber: a full queue drops the oldest message, even if not acknowledged
STATE = keep_last(10, reliable=True)
#: Subscribers of the graph to sensors and states: newest sample only
SENSOR = keep_last(1, reliable=False)
#: Subscribers that need every sensor sample: deep enough for a busy subscriber
SENSOR_QUEUE = keep_last(100, reliable=False)
#: ``/robot_description``, ``/mode``: late subscribers receive the last value
LATCHED = keep_last(1, reliable=True, latched=True)
#: ``/refusals``, ``gait/route_status``: none may be lost, and late subscribers receive the last ones
LATCHED_EVENT = keep_last(10, reliable=True, latched=True)
#: Requests and replies: none may be lost
EVENT = keep_last(10, reliable=True)
#: The same of several senders at high rates: deep enough for a busy subscriber
EVENT_QUEUE = keep_last(100, reliable=True)
#: Joint commands without deadline, for publishers slower than the controller
COMMAND = keep_last(1, reliable=True)


def sensor(*, lockstep: bool, waits: bool) -> QoSProfile:
    """Subscriber to sensors: newest sample only; all samples if the plant ``waits``; reliable in ``lockstep``."""
    return STATE if lockstep else SENSOR_QUEUE if waits else SENSOR


def command(deadline_s: float | None = None) -> QoSProfile:
    """Joint commands: reliable, newest only; offered deadline [s], disabled when None."""
    return keep_last(1, reliable=True, deadline_s=deadline_s)


#: Time before a mismatch is checked against the graph; its event may precede the discovery of the endpoint [s]
SETTLE_TIME = 1.0
INCOMPATIBLE_QOS = "incompatible QoS"  #: Prefix of the key in diagnostics; the topic follows
PUBLISHER, SUBSCRIBER = "publisher", "subscriber"


class Endpoint(NamedTuple):
    """Remote end of a topic, named as in the node; ``other`` is ``PUBLISHER`` or ``SUBSCRIBER``."""

    topic: str
    other: str


class Mismatch(NamedTuple):
    """Last event: policy such as ``RELIABILITY``, local QoS profile, and monotonic time [s]."""

    policy: str
    qos: QoSProfile
    seen: float


class QosWatch:
    """Records QoS mismatches from middleware events, and queries the graph for whether the other end still exists.

    Events occur at discovery, not in a tick. Without a mismatch ``look`` costs nothing. No event reports the removal of
    an endpoint, so ``look`` compares profiles; a killed endpoint disappears with its lease, up to 20 s later.
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
        """Drop mismatches without remote endpoint. A graph query takes about 0.1 ms each: not for use in a tick."""
        now = time.monotonic()
        for end, mismatch in list(self._found.items()):
            if now - mismatch.seen >= SETTLE_TIME and not self._stands(end, mismatch.qos):
                del self._found[end]
                self._node.get_logger().info(f"'{end.topic}': no {end.other} with incompatible QoS any more")

    def forget(self, topic: str) -> None:
        """Drop the mismatches of a topic that the node no longer uses."""
        for other in (PUBLISHER, SUBSCRIBER):
            self._found.pop(Endpoint(topic, other), None)

    def values(self) -> dict[str, str]:
        """Items for the diagnostics; empty without mismatch."""
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
        """Whether an incompatible remote endpoint still exists."""
        if end.other == PUBLISHER:
            offered = self._node.get_publishers_info_by_topic(end.topic)
            pairs = [(info.qos_profile, qos) for info in offered]
        else:
            requested = self._node.get_subscriptions_info_by_topic(end.topic)
            pairs = [(qos, info.qos_profile) for info in requested]
        return any(qos_check_compatible(*pair)[0] == QoSCompatibility.ERROR for pair in pairs)
