"""The scanner of the simulated robot as a topic."""

from __future__ import annotations

from sensor_msgs.msg import LaserScan

from bridge.laser_scanner import LaserScanner
from bridge.mujoco_plant import MujocoPlant
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import to_seconds
from models.nodes.qos import sensor
from models.nodes.scan import scan_to_message


class ScanPublisher:
    """Publishes ``scan`` at the scanner's rate while somebody listens; nothing for a robot without scanner.

    Args:
        node: Node that publishes.
        plant: The simulated robot.
        seed: Of the scanner's noise.
        noise: Factor on it.
        reliable: Whether no scan may be lost (lockstep).
    """

    def __init__(self, node: PoiseNode, plant: MujocoPlant, *, seed: int, noise: float, reliable: bool) -> None:
        self._plant = plant
        self._last = 0
        self._ticks = 0
        if plant.robot.profile.sensors.scan is None:
            return
        self._scanner = LaserScanner(plant, seed, noise)
        self._period = 1.0 / self._scanner.config.rate
        self._ticks = max(round(self._period / plant.period), 1)
        self._publisher = node.announce(LaserScan, topics.SCAN, sensor(reliable=reliable))

    def publish(self, tick: int, stamp: int) -> None:
        """Publish a scan at a stamp [ns], where this tick is due for one and has not had it."""
        if not self._ticks or tick % self._ticks or stamp == self._last or not self._publisher.get_subscription_count():
            return
        self._last = stamp
        scan = self._plant.seen(self._scanner.scan(to_seconds(stamp)))
        if scan is not None:
            self._publisher.publish(scan_to_message(stamp, scan, self._period))
