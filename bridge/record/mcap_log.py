"""MCAP files of serialised ROS 2 messages, for Foxglove, PlotJuggler and ``ros2 bag``."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Protocol

from mcap.writer import Writer

from models.files import part_beside
from models.nodes.imu import ImuSample
from models.nodes.message_text import message_text


class McapLog:
    """Serialised messages with their definitions; the file appears at ``close``. ``PoiseError`` when not writable."""

    def __init__(self, path: Path) -> None:
        self._path, self._part = path, part_beside(path)
        self._file = self._part.open("wb")
        self._writer = Writer(self._file)
        self._writer.start(profile="ros2", library=f"poise {version('poise')}")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self.counts: dict[str, int] = {}

    def announce(self, topic: str, kind: str) -> None:
        """Declare the type of a topic before its first message; ``MessageError`` when it is not installed."""
        if kind not in self._schemas:
            text = message_text(kind)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        self.counts[topic] = 0

    def add(self, topic: str, data: bytes, stamp: int, sent: int | None = None) -> None:
        """Write a serialised message at a log time [ns]; ``sent`` is the publish time [ns], if different."""
        count = self.counts[topic]
        self._writer.add_message(self._channels[topic], stamp, data, stamp if sent is None else sent, count)
        self.counts[topic] = count + 1

    def describe(self, name: str, data: Mapping[str, str]) -> None:
        """Write metadata."""
        self._writer.add_metadata(name, dict(data))

    def close(self) -> None:
        """Complete the file and move it to its path."""
        self._writer.finish()
        self._file.close()
        self._part.replace(self._path)

    def discard(self) -> None:
        """Delete the incomplete file."""
        self._file.close()
        self._part.unlink()


class ImuLog(Protocol):
    """Log of samples."""

    def add(self, stamp: int, sample: ImuSample, data: bytes) -> None:
        """Write a sample of a stamp [ns] with its serialised message."""
        ...

    def close(self) -> None:
        """Complete the file and move it to its path."""
        ...

    def discard(self) -> None:
        """Delete the incomplete file."""
        ...


class McapImuLog:
    """The received messages, with their stamps as the time of the log; arguments and errors as ``McapLog``."""

    def __init__(self, path: Path, topic: str) -> None:
        self._log, self._topic = McapLog(path), topic
        self._log.announce(topic, "sensor_msgs/msg/Imu")

    def add(self, stamp: int, sample: ImuSample, data: bytes) -> None:
        """Write the message."""
        self._log.add(self._topic, data, stamp)

    def close(self) -> None:
        """Complete the file and move it to its path."""
        self._log.close()

    def discard(self) -> None:
        """Delete the incomplete file."""
        self._log.discard()
