"""MCAP files of serialised ROS 2 messages, for Foxglove, PlotJuggler and ``ros2 bag``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from mcap.writer import Writer

from models.nodes.message_text import message_text
from models.part_file import part_beside


class McapLog:
    """Messages as they came, with their definitions; the file has its name only once it is complete.

    Args:
        path: Where the file appears at ``close``.

    Attributes:
        counts: Messages by topic.

    Raises:
        PoiseError: It cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, part_beside(path)
        self._file = self._part.open("wb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library=f"poise {version('poise')}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self.counts: dict[str, int] = {}

    def announce(self, topic: str, kind: str, definition: str = "") -> None:
        """Say what a topic carries; once, before its first message.

        Args:
            topic: Its name.
            kind: Type, such as ``sensor_msgs/msg/Imu``.
            definition: Text of the type and what it consists of; that of the installed packages when empty.

        Raises:
            MessageError: The definition is not installed.
        """
        if kind not in self._schemas:
            text = definition or message_text(kind)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        self.counts[topic] = 0

    def add(self, topic: str, data: bytes, stamp: int, sent: int | None = None) -> None:
        """Write a message.

        Args:
            topic: One that was announced.
            data: The message, serialised.
            stamp: Time of the log [ns].
            sent: Time at which it was published [ns]; ``stamp`` when None.
        """
        count = self.counts[topic]
        self._writer.add_message(self._channels[topic], stamp, data, stamp if sent is None else sent, count)
        self.counts[topic] = count + 1

    def describe(self, name: str, data: Mapping[str, str]) -> None:
        """Write what the file is about."""
        self._writer.add_metadata(name, dict(data))

    def close(self) -> None:
        """Complete the file and give it its name."""
        self._writer.finish()
        self._file.close()
        self._part.replace(self._path)

    def discard(self) -> None:
        """Leave no file."""
        self._file.close()
        self._part.unlink()
