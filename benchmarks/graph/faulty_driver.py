"""Driver that corrupts its messages on command: ``/corrupt`` takes ``TOPIC KIND COUNT``."""

from array import array
from collections.abc import Callable
from typing import Any

from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String

from bridge.driver.run_loop import run_plant
from bridge.nodes.robot_driver import RobotDriver
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import set_stamp, stamp_ns
from models.nodes.qos import EVENT
from models.nodes.spin import program

SHIFT = NANOSECONDS  # offset of an old or future stamp [ns]
TICK = NANOSECONDS // 1000  # time between two messages of a sensor [ns]
HOUR = 3600 * NANOSECONDS  # jump of ``/clock`` [ns]

Corruption = Callable[[Any, int], Any]


def stamp_field(message: Any) -> Any:
    """Return the field with the time of a message."""
    return message.clock if hasattr(message, "clock") else message.header.stamp


def _stamped(change: Callable[[int, int], int]) -> Corruption:
    """Change the stamp, given its value and the stamp of the first corrupted message [ns]."""

    def corrupt(message: Any, began: int) -> Any:
        field = stamp_field(message)
        set_stamp(field, max(change(stamp_ns(field), began), 0))
        return message

    return corrupt


def _joints(change: Callable[[list[Any]], list[Any]], name: Callable[[list[str]], list[str]]) -> Corruption:
    """Change joint names, and positions, velocities and efforts in the same order."""

    def corrupt(message: Any, began: int) -> Any:
        message.name = name(list(message.name))
        for field in ("position", "velocity", "effort"):
            setattr(message, field, array("d", change(list(getattr(message, field)))))
        return message

    return corrupt


def _unnormalised(message: Any, began: int) -> Any:
    orientation = message.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = 0.5, 0.5, 0.5, 2.0
    return message


CORRUPTIONS: dict[str, Corruption] = {
    "silent": lambda message, began: None,
    "repeated": _stamped(lambda now, began: began),
    "backward": _stamped(lambda now, began: 2 * began - now),
    "old": _stamped(lambda now, began: now - SHIFT),
    "future": _stamped(lambda now, began: now + SHIFT),
    "jumping": _stamped(lambda now, began: now + SHIFT * ((now - began) // TICK % 2)),
    "hour_back": _stamped(lambda now, began: now - HOUR),
    "hour_ahead": _stamped(lambda now, began: now + HOUR),
    "reordered": _joints(lambda values: values[::-1], lambda names: names[::-1]),
    "missing": _joints(lambda values: values[:-1], lambda names: names[:-1]),
    "extra": _joints(lambda values: [*values, 0.0], lambda names: [*names, "tail_joint"]),
    "duplicate": _joints(lambda values: values, lambda names: [*names[:-1], names[0]]),
    "unnormalised": _unnormalised,
}

CORRUPT = "corrupt"  # topic of the commands


class CorruptingPublisher:
    """Publisher that corrupts messages on request."""

    def __init__(self, publisher: Any, kind: type) -> None:
        self._publisher, self._kind = publisher, kind
        self._corruption, self._left = "", 0
        self._began: int | None = None

    def corrupt(self, corruption: str, count: int) -> None:
        """Corrupt the next ``count`` messages; see ``CORRUPTIONS``."""
        self._corruption, self._left, self._began = corruption, count, None

    def get_subscription_count(self) -> int:
        """Return the count of the wrapped publisher."""
        return int(self._publisher.get_subscription_count())

    def publish(self, message: Any) -> None:
        """Publish a message or its bytes."""
        if self._left:
            self._left -= 1
            message = self._corrupted(message)
        if message is not None:
            self._publisher.publish(message)

    def _corrupted(self, message: Any) -> Any:
        raw = isinstance(message, bytes)
        decoded = deserialize_message(message, self._kind) if raw else message
        if self._began is None:
            self._began = stamp_ns(stamp_field(decoded))
        corrupted = CORRUPTIONS[self._corruption](decoded, self._began)
        return serialize_message(corrupted) if raw and corrupted is not None else corrupted


class FaultyDriver(RobotDriver):
    """``RobotDriver`` whose publishers can corrupt messages."""

    def __init__(self, **kwargs: Any) -> None:
        self._corrupting: dict[str, CorruptingPublisher] = {}
        super().__init__(**kwargs)

    def configure(self) -> None:
        super().configure()
        self.listen(String, CORRUPT, self._on_corrupt, EVENT)

    def announce(self, kind: type, topic: str, qos: Any) -> Any:
        self._corrupting[topic] = CorruptingPublisher(super().announce(kind, topic, qos), kind)
        return self._corrupting[topic]

    def _on_corrupt(self, message: String) -> None:
        topic, corruption, count = message.data.split()
        self._corrupting[topic].corrupt(corruption, int(count))


if __name__ == "__main__":
    program(FaultyDriver, loop=run_plant)()
