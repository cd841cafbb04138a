"""Quality of service of every topic of the graph, in one place."""

from __future__ import annotations

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

SENSOR = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""Sensors and states: only the newest sample matters."""

SENSOR_QUEUE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=100,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)
"""Sensors for a listener that counts or logs: deep enough that a busy one does not lose samples by itself."""

LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""``/robot_description``, ``/mode``: late subscribers get the last value."""

EVENT = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Requests and replies: none may be lost."""

COMMAND = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Joint commands without an offered or requested deadline, for commanders slower than the controller."""


SENSOR_RELIABLE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.VOLATILE,
)
"""Sensors in lockstep: the plant waits for the answer, so no sample may be lost."""


def sensor(*, reliable: bool) -> QoSProfile:
    """Profile of the sensor topics: best effort, or reliable in lockstep."""
    return SENSOR_RELIABLE if reliable else SENSOR


def command(deadline_s: float | None = None) -> QoSProfile:
    """Joint commands: reliable, newest only, with a deadline that DDS watches.

    Args:
        deadline_s: Longest gap between two commands [s]; None for no deadline.

    Returns:
        The profile.
    """
    if deadline_s is None:
        return COMMAND
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=1,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.VOLATILE,
        deadline=Duration(nanoseconds=round(deadline_s * 1e9)),
    )
