"""Main loop of a plant: absolute deadlines in real time, waits for late commands, one command per tick in lockstep."""

import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from rclpy.utilities import ok

from models.errors import ConfigError
from models.nodes.spin import Stop

_NANO = 1e-9  #: One nanosecond [s]


class Pacer:
    """Runs a loop at a fixed period [s] without drift: deadline k is at start + k period.

    A late tick does not shift later deadlines. Whole lost periods are skipped and counted in ``skipped``, so that no
    burst follows a long stall. ``clock`` is monotonic [ns], ``sleep`` sleeps for a time [s]. Raises ``ConfigError``
    unless ``period`` is positive.
    """

    def __init__(
        self,
        period: float,
        *,
        clock: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not 0.0 < period < float("inf"):
            raise ConfigError(f"period: {period} s is not positive")
        self._period = round(period / _NANO)
        self._clock, self._sleep = clock, sleep
        self._deadline = clock() + self._period
        self.skipped = 0

    def wait(self) -> float:
        """Sleep until the next deadline, not at all if it has passed; returns the delay after it [s]."""
        now = self._clock()
        if now > self._deadline:
            missed = (now - self._deadline) // self._period
            self.skipped += missed
            self._deadline += missed * self._period
        while now < self._deadline:  # repeated after an early wake-up
            self._sleep((self._deadline - now) * _NANO)
            now = self._clock()
        late = now - self._deadline
        self._deadline += self._period
        return late * _NANO


IDLE_SPIN = 0.02  #: Longest wait for a callback while no tick is due [s]
ARRIVAL_POLL = 0.0004  #: Time between two checks for a sample of a real robot [s]
#: Longest tick of a real robot, in periods, to allow for jitter; 1 after a missing sample, to time the silence
TICK_MAX = 1.5
RETRY_PERIOD_NS = 100_000_000  #: Timeout for a command, after which the tick's sensors are published again [ns]


class Paced(Protocol):
    """Node driven by ``run_plant``, with a real-time ``period`` [s] and at least ``callbacks_min`` callbacks a tick."""

    lockstep: bool
    period: float
    callbacks_min: int

    @property
    def follows_samples(self) -> bool:
        """Whether the robot's samples trigger the ticks, because it has a clock (a real robot)."""

    @property
    def sample_due(self) -> bool:
        """Whether the next sample of a real robot has arrived."""

    @property
    def command_due(self) -> bool:
        """Whether a command may be sent to the plant: a new one has arrived, or none is awaited."""

    @property
    def fresh(self) -> bool:
        """Whether the last tick of a real robot had a new sample."""

    @property
    def running(self) -> bool:
        """Whether the plant's time advances."""

    @property
    def answered(self) -> bool:
        """Whether the drivers have received the command of this tick."""

    @property
    def free_running(self) -> bool:
        """Lockstep: whether the plant steps without a command, because none is due."""

    @property
    def behind(self) -> bool:
        """Whether simulated time waits for late commands, a late supervisor or late perception."""

    def publish_tick(self, late: float) -> None:
        """Publish the sensors of this tick, which began ``late`` after its deadline [s]."""

    def step(self) -> None:
        """Advance by one tick."""

    def overrun(self, ticks: int) -> None:
        """Count skipped ticks, zero or more."""

    def idle(self) -> None:
        """Publish a heartbeat; called regularly while the plant's time stands still."""


def run_plant(executor: Any, nodes: Sequence[Any], stop: Stop) -> None:
    """Serve callbacks and drive the first node until a signal.

    In real time tick k begins at t0 + k T on the monotonic clock. The sensors are published, callbacks are served until
    the next deadline, then the plant gets the newest command. Whole lost periods are counted and skipped; simulated
    time does not catch up. While commands lag behind the sensors, a simulated plant waits. A tick of a real robot
    begins with its sample; the robot gets the command as soon as it arrives.
    """
    node: Paced = nodes[0]
    pacer: Pacer | None = None
    skipped = 0
    late = 0.0
    while ok() and not stop.requested:
        if not node.running:
            executor.spin_once(timeout_sec=IDLE_SPIN)
            node.idle()
            pacer = None
            continue
        if node.follows_samples:
            node.publish_tick(0.0)
            _follow_sample(executor, node, stop)
            continue
        if pacer is None:
            pacer = Pacer(node.period, sleep=lambda seconds: executor.spin_once(timeout_sec=seconds))
            skipped = 0
        node.publish_tick(late)
        for _ in range(node.callbacks_min):
            executor.spin_once(timeout_sec=0.0)
        if node.lockstep and not node.free_running:
            _serve_while(executor, node, stop, lambda: not node.answered and not node.free_running)
        else:
            late = pacer.wait()
            node.overrun(pacer.skipped - skipped)
            skipped = pacer.skipped
            if node.behind:
                _serve_while(executor, node, stop, lambda: node.behind)
                pacer = None
        if node.running and not stop.requested:
            node.step()


def _follow_sample(executor: Any, node: Paced, stop: Stop) -> None:
    """Serve callbacks until the next sample; step once, at the first new command or at the end."""
    began = time.monotonic()
    longest = node.period * (TICK_MAX if node.fresh else 1.0)
    stepped = False
    while ok() and not stop.requested and node.running:
        executor.spin_once(timeout_sec=ARRIVAL_POLL)
        if not stepped and node.command_due:
            node.step()
            stepped = True
        if node.sample_due or time.monotonic() - began >= longest:
            break
    if not stepped and node.running and not stop.requested:
        node.step()


def _serve_while(executor: Any, node: Paced, stop: Stop, waiting: Callable[[], bool]) -> None:
    """Serve callbacks while the plant waits for a command; publish the sensors again after a timeout."""
    retry_at = time.monotonic_ns() + RETRY_PERIOD_NS
    while ok() and not stop.requested and node.running and waiting():
        executor.spin_once(timeout_sec=RETRY_PERIOD_NS * _NANO)
        if time.monotonic_ns() >= retry_at and waiting():
            retry_at = time.monotonic_ns() + RETRY_PERIOD_NS
            node.publish_tick(0.0)
            node.idle()
