"""Who on a node's topics cannot hear it, or be heard, because the two ends do not agree on the quality of service."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible, qos_policy_name_from_kind

from models.nodes import topics

SETTLE_TIME = 1.0
"""How long a mismatch counts whatever the graph says: the event may come before the graph knows the other end [s]."""

PUBLISHER, SUBSCRIBER = "publisher", "subscriber"


class Endpoint(NamedTuple):
    """One end of a topic.

    Attributes:
        topic: Name as the node uses it.
        other: What stands at the other end, ``PUBLISHER`` or ``SUBSCRIBER``.
    """

    topic: str
    other: str


class Mismatch(NamedTuple):
    """What the middleware has told last.

    Attributes:
        policy: The policy on which the ends do not agree, for example ``RELIABILITY``.
        qos: Profile of the node's own end.
        seen: When it was told, on the monotonic clock [s].
    """

    policy: str
    qos: QoSProfile
    seen: float


class QosWatch:
    """Notes mismatches from the middleware's events, and asks the graph whether the other end is still there.

    The events come when somebody is discovered, never in a tick; without a mismatch ``look`` costs nothing. Nothing is
    told when the other end goes, so ``look`` compares profiles; one that was killed goes when its lease ends, up to
    20 s later.

    Args:
        node: rclpy node whose endpoints are watched.
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
        """Forget the mismatches whose other ends are gone. Asks the graph, about 0.1 ms for each: never in a tick."""
        now = time.monotonic()
        for end, mismatch in list(self._found.items()):
            if now - mismatch.seen >= SETTLE_TIME and not self._stands(end, mismatch.qos):
                del self._found[end]
                self._node.get_logger().info(f"'{end.topic}': no {end.other} with incompatible QoS any more")

    def forget(self, topic: str) -> None:
        """The node gives up its end."""
        for other in (PUBLISHER, SUBSCRIBER):
            self._found.pop(Endpoint(topic, other), None)

    def values(self) -> dict[str, str]:
        """Items for the diagnostics; none when all agree."""
        return {
            f"{topics.INCOMPATIBLE_QOS} {end.topic}": f"{end.other}: {mismatch.policy}"
            for end, mismatch in self._found.items()
        }

    def _note(self, end: Endpoint, qos: QoSProfile, event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        if end not in self._found:
            self._node.get_logger().warning(f"'{end.topic}' has a {end.other} with incompatible QoS: {policy}")
        self._found[end] = Mismatch(policy, qos, time.monotonic())

    def _stands(self, end: Endpoint, qos: QoSProfile) -> bool:
        """Whether the graph knows somebody at the other end that does not go with a profile."""
        if end.other == PUBLISHER:
            offered = self._node.get_publishers_info_by_topic(end.topic)
            pairs = [(info.qos_profile, qos) for info in offered]
        else:
            wanted = self._node.get_subscriptions_info_by_topic(end.topic)
            pairs = [(qos, info.qos_profile) for info in wanted]
        return any(qos_check_compatible(*pair)[0] == QoSCompatibility.ERROR for pair in pairs)
