"""The simulated robot with messages that are spoilt on command: ``/spoil`` says ``TOPIC KIND COUNT``."""

from __future__ import annotations

import sys
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String

from benchmarks.nodes.spoils import SPOILS, stamp_field
from bridge.nodes.mujoco_bridge import MujocoBridge
from bridge.ros.run_loop import run_plant
from models.nodes.messages import stamp_ns
from models.nodes.qos import EVENT
from models.nodes.spin import run

SPOIL = "spoil"
"""Topic of the commands."""


class SpoiltPublisher:
    """Publishes what another one would, or something worse.

    Args:
        publisher: Takes the messages.
        kind: Their type.
    """

    def __init__(self, publisher: Any, kind: type) -> None:
        self._publisher, self._kind = publisher, kind
        self._spoil, self._left = "", 0
        self._began: int | None = None

    def spoil(self, spoil: str, count: int) -> None:
        """Spoil so many messages from now on; see ``SPOILS``."""
        self._spoil, self._left, self._began = spoil, count, None

    def get_subscription_count(self) -> int:
        """Of the other one."""
        return int(self._publisher.get_subscription_count())

    def publish(self, message: Any) -> None:
        """Publish a message or its bytes."""
        if self._left:
            self._left -= 1
            message = self._spoilt(message)
        if message is not None:
            self._publisher.publish(message)

    def _spoilt(self, message: Any) -> Any:
        raw = isinstance(message, bytes)
        decoded = deserialize_message(message, self._kind) if raw else message
        if self._began is None:
            self._began = stamp_ns(stamp_field(decoded))
        spoilt = SPOILS[self._spoil](decoded, self._began)
        return serialize_message(spoilt) if raw and spoilt is not None else spoilt


class SpoiltBridge(MujocoBridge):
    """``MujocoBridge`` between whose messages and the middleware somebody sits.

    Args:
        kwargs: Passed to rclpy.
    """

    def __init__(self, **kwargs: Any) -> None:
        self._spoilt: dict[str, SpoiltPublisher] = {}
        super().__init__(**kwargs)

    def configure(self) -> None:
        """Listen to what is to be spoilt, too."""
        super().configure()
        self.listen(String, SPOIL, self._on_spoil, EVENT)

    def announce(self, kind: type, topic: str, qos: Any) -> Any:
        """Publisher whose messages can be spoilt."""
        self._spoilt[topic] = SpoiltPublisher(super().announce(kind, topic, qos), kind)
        return self._spoilt[topic]

    def _on_spoil(self, message: String) -> None:
        topic, spoil, count = message.data.split()
        self._spoilt[topic].spoil(spoil, int(count))


def main(args: list[str] | None = None) -> None:
    """Run the node in a process of its own."""
    sys.exit(run([SpoiltBridge], args, run_plant))


if __name__ == "__main__":
    main()
