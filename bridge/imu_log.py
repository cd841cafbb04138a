"""Logs of the inertial unit as CSV and MCAP; a file has its name only once it is complete."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from bridge.mcap_log import McapLog
from models.nodes.imu import ImuSample


class ImuLog(Protocol):
    """Takes samples until it is closed."""

    def add(self, stamp: int, sample: ImuSample, data: bytes) -> None:
        """Write a sample of a stamp [ns], which came as these bytes."""
        ...

    def close(self) -> None:
        """Complete the file and give it its name."""
        ...

    def discard(self) -> None:
        """Leave no file."""
        ...


class McapImuLog:
    """The messages as they came, with their own stamps as the time of the log.

    Args:
        path: Where the file appears at ``close``.
        topic: Name of the topic.

    Raises:
        PoiseError: It cannot be written.
    """

    def __init__(self, path: Path, topic: str) -> None:
        self._log, self._topic = McapLog(path), topic
        self._log.announce(topic, "sensor_msgs/msg/Imu")

    def add(self, stamp: int, sample: ImuSample, data: bytes) -> None:
        """Write the message."""
        self._log.add(self._topic, data, stamp)

    def close(self) -> None:
        """Complete the file and give it its name."""
        self._log.close()

    def discard(self) -> None:
        """Leave no file."""
        self._log.discard()
