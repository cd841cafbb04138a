"""Receives ``imu/data`` of a running robot and passes every sample on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import Imu

from bridge.ros.environment import join_graph
from bridge.ros.processes import absolute_namespace, in_namespace
from models.errors import CommandError, MessageError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS
from models.nodes.imu import ImuSample, OrientedImuCodec
from models.nodes.qos import SENSOR_QUEUE
from models.nodes.spin import Stop, log_arguments

SPIN = 0.1  #: Longest wait for a callback [s]


class ImuListener:
    """Passes samples to ``take`` (stamp [ns], sample, serialised message) and counts them.

    ``first`` and ``last`` are stamps [ns], None before the first; ``refused`` counts malformed messages, and stamps
    that are not newer than the last one.
    """

    def __init__(self, take: Callable[[int, ImuSample, bytes], None]) -> None:
        self._take, self._codec = take, OrientedImuCodec(topics.IMU_FRAME)
        self.first: int | None = None
        self.last = self.count = self.refused = 0

    @property
    def duration(self) -> float:
        """Time from the first sample to the newest [s]."""
        return 0.0 if self.first is None else (self.last - self.first) / NANOSECONDS

    def on_message(self, data: bytes) -> None:
        """Pass a message on."""
        try:
            stamp, sample = self._codec.decode(data)
        except MessageError:
            self.refused += 1
            return
        if self.first is not None and stamp <= self.last:
            self.refused += 1
            return
        self.first = stamp if self.first is None else self.first
        self.last = stamp
        self.count += 1
        self._take(stamp, sample, bytes(data))

    def listen(
        self, seconds: float | None, stop: Stop, *, network: bool = False, namespace: str = "", silence: float = 5.0
    ) -> None:
        """Pass samples on for a time on their stamps [s], or until a signal, which never interrupts a sample.

        ``stop`` is set by the signal; with ``network`` the robot may run on another machine. Raises ``CommandError``
        when no sample arrives within ``silence`` [s].
        """
        join_graph(network=network)
        context = Context()
        args = [*sys.argv, *log_arguments()]
        rclpy.init(args=args, context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = Node("poise_imu_log", context=context, **in_namespace(absolute_namespace(namespace)))
        executor = SingleThreadedExecutor(context=context)
        try:
            executor.add_node(node)
            node.create_subscription(Imu, topics.IMU_DATA, self.on_message, SENSOR_QUEUE, raw=True)
            heard, since = self.count, time.monotonic()
            while not stop.requested and (seconds is None or self.duration < seconds):
                executor.spin_once(timeout_sec=SPIN)
                if self.count != heard:
                    heard, since = self.count, time.monotonic()
                elif time.monotonic() - since > silence:
                    raise CommandError(f"{topics.IMU_DATA} is silent for {silence:.0f} s: is the robot up? (poise up)")
        finally:
            executor.shutdown()
            node.destroy_node()
            try_shutdown(context=context)
