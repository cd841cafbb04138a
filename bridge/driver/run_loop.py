"""Paces a plant: absolute deadlines in real time, waiting for late commands, or one command per tick in lockstep."""

import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from rclpy.utilities import ok

from models.errors import ConfigError
from models.nodes.spin import Stop

_NANO = 1e-9  #: One nanosecond [s]


class Pacer:
    """Keeps a loop at a fixed period [s] without drift: deadline k is at start + k period.

    A late tick does not move the deadlines after it. Lost whole periods are skipped and counted, so that no burst
    follows a long stall; ``skipped`` is their number. ``clock`` is monotonic [ns], ``sleep`` sleeps for a time [s].
    Raises ``ConfigError`` unless ``period`` is positive.
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
        """Sleep until the next deadline, or return at once when it has passed; returns how late it is [s]."""
        now = self._clock()
        if now > self._deadline:
            missed = (now - self._deadline) // self._period
            self.skipped += missed
            self._deadline += missed * self._period
        while now < self._deadline:  # again after waking early
            self._sleep((self._deadline - now) * _NANO)
            now = self._clock()
        late = now - self._deadline
        self._deadline += self._period
        return late * _NANO


IDLE_SPIN = 0.02  #: Longest wait for a callback while no tick is due [s]
ARRIVAL_POLL = 0.0004  #: Time between two checks for a sample of a robot with its own clock [s]
#: Longest tick of such a robot, in periods: its samples jitter; once one is missing, ticks count the silence exactly
TICK_MAX = 1.5
RETRY_PERIOD_NS = 100_000_000  #: Wait for a command after which the tick's sensors are published again [ns]


class Paced(Protocol):
    """Node that ``run_plant`` drives, with a real ``period`` [s] and at least ``callbacks_min`` callbacks per tick."""

    lockstep: bool
    period: float
    callbacks_min: int

    @property
    def follows_samples(self) -> bool:
        """Whether ticks begin with the samples of a robot that has its own clock."""

    @property
    def sample_due(self) -> bool:
        """Whether the next sample of such a robot has arrived."""

    @property
    def command_due(self) -> bool:
        """Whether the plant may be given its command: a new one has come, or none is awaited."""

    @property
    def fresh(self) -> bool:
        """Whether the last tick of such a robot had a new sample."""

    @property
    def running(self) -> bool:
        """Whether the plant's time advances."""

    @property
    def answered(self) -> bool:
        """Whether the drivers have the command of this tick."""

    @property
    def free_running(self) -> bool:
        """Lockstep: whether the plant steps without an answer, because no command is due."""

    @property
    def behind(self) -> bool:
        """Whether simulated time waits for the commands, which lag."""

    def publish_tick(self, late: float) -> None:
        """Publish the sensors of this tick, which began ``late`` after its deadline [s]."""

    def step(self) -> None:
        """Advance by one tick."""

    def overrun(self, ticks: int) -> None:
        """Count skipped ticks, possibly none."""

    def idle(self) -> None:
        """Publish a heartbeat; called regularly while the plant's time stands still."""


def run_plant(executor: Any, nodes: Sequence[Any], stop: Stop) -> None:
    """Serve callbacks and drive the first node until a signal.

    In real time tick k begins at t0 + k T on the monotonic clock. Its sensors are published, callbacks are served until
    the next deadline, then the plant gets the newest command. Lost whole periods are counted and skipped: simulated
    time then falls behind and never catches up. While the commands lag behind the sensors, a simulated plant waits. A
    robot with its own clock is followed: a tick begins with its sample, and it gets the command as soon as that comes.
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
    """Serve callbacks until the next sample; step once, with the first new command or at the end."""
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
    """Serve callbacks while the plant waits for a command; publish the sensors again when none comes."""
    retry_at = time.monotonic_ns() + RETRY_PERIOD_NS
    while ok() and not stop.requested and node.running and waiting():
        executor.spin_once(timeout_sec=RETRY_PERIOD_NS * _NANO)
        if time.monotonic_ns() >= retry_at and waiting():
            retry_at = time.monotonic_ns() + RETRY_PERIOD_NS
            node.publish_tick(0.0)
            node.idle()
