"""A bridge with messages that are spoilt on command: ``/spoil`` takes ``TOPIC KIND COUNT``."""

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

SHIFT = NANOSECONDS  # how far an old or future stamp is off [ns]
TICK = NANOSECONDS // 1000  # between two messages of a sensor [ns]
HOUR = 3600 * NANOSECONDS  # how far ``/clock`` jumps [ns]

Spoil = Callable[[Any, int], Any]


def stamp_field(message: Any) -> Any:
    """Where a message has its time."""
    return message.clock if hasattr(message, "clock") else message.header.stamp


def _stamped(change: Callable[[int, int], int]) -> Spoil:
    """Another stamp, from that of now and that of the first spoilt message [ns]."""

    def spoil(message: Any, began: int) -> Any:
        field = stamp_field(message)
        set_stamp(field, max(change(stamp_ns(field), began), 0))
        return message

    return spoil


def _joints(change: Callable[[list[Any]], list[Any]], name: Callable[[list[str]], list[str]]) -> Spoil:
    """Other joints: their names, and their numbers in the same order."""

    def spoil(message: Any, began: int) -> Any:
        message.name = name(list(message.name))
        for field in ("position", "velocity", "effort"):
            setattr(message, field, array("d", change(list(getattr(message, field)))))
        return message

    return spoil


def _unnormalised(message: Any, began: int) -> Any:
    orientation = message.orientation
    orientation.x, orientation.y, orientation.z, orientation.w = 0.5, 0.5, 0.5, 2.0
    return message


SPOILS: dict[str, Spoil] = {
    "silent": lambda message, began: None,
    "repeated": _stamped(lambda now, began: began),
    "backward": _stamped(lambda now, began: 2 * began - now),
    "old": _stamped(lambda now, began: now - SHIFT),
    "future": _stamped(lambda now, began: now + SHIFT),
    "leaping": _stamped(lambda now, began: now + SHIFT * ((now - began) // TICK % 2)),
    "hour_back": _stamped(lambda now, began: now - HOUR),
    "hour_ahead": _stamped(lambda now, began: now + HOUR),
    "reordered": _joints(lambda values: values[::-1], lambda names: names[::-1]),
    "missing": _joints(lambda values: values[:-1], lambda names: names[:-1]),
    "extra": _joints(lambda values: [*values, 0.0], lambda names: [*names, "tail_joint"]),
    "duplicate": _joints(lambda values: values, lambda names: [*names[:-1], names[0]]),
    "unnormalised": _unnormalised,
}

SPOIL = "spoil"  # topic of the commands


class SpoiltPublisher:
    """Publisher that spoils messages on request before it passes them on."""

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


class SpoiltBridge(RobotDriver):
    """``RobotDriver`` whose publishers can spoil messages."""

    def __init__(self, **kwargs: Any) -> None:
        self._spoilt: dict[str, SpoiltPublisher] = {}
        super().__init__(**kwargs)

    def configure(self) -> None:
        super().configure()
        self.listen(String, SPOIL, self._on_spoil, EVENT)

    def announce(self, kind: type, topic: str, qos: Any) -> Any:
        self._spoilt[topic] = SpoiltPublisher(super().announce(kind, topic, qos), kind)
        return self._spoilt[topic]

    def _on_spoil(self, message: String) -> None:
        topic, spoil, count = message.data.split()
        self._spoilt[topic].spoil(spoil, int(count))


if __name__ == "__main__":
    program(SpoiltBridge, loop=run_plant)()
