"""The scanner's topic, into the obstacle stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import LaserScan

from controllers.obstacle_stop import ObstacleStop
from models.errors import MessageError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.qos import SENSOR
from models.nodes.scan import scan_from_message


class ScanTopic:
    """Feeds scans to the law; malformed, old and future ones are refused by name.

    Args:
        node: Node that subscribes, where the robot has a scanner.
        law: Gets the scans.
        now: Time of ``/clock`` [s]; while it is 0, before anything was heard of it, scans are left alone.
    """

    def __init__(self, node: PoiseNode, law: ObstacleStop, now: Callable[[], float]) -> None:
        self._node, self._law, self._now = node, law, now
        if law.expected:
            node.listen(LaserScan, topics.SCAN, self._on_scan, SENSOR)

    def _on_scan(self, message: Any) -> None:
        now = self._now()
        if not now:
            return
        try:
            scan = scan_from_message(message)
            if abs(now - scan.t) > self._law.config.scan_timeout:
                raise MessageError(f"header.stamp: {scan.t:.3f} s, while /clock is at {now:.3f} s")
            if self._law.stamp is not None and self._law.stamp > now + self._law.config.scan_timeout:
                self._law.reset()  # /clock has begun anew: the bridge was restarted
            self._law.update(scan)
        except PoiseError as error:
            self._node.refuse(topics.SCAN, error)
