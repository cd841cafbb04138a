"""Real-time set-up of a process, and timing of its ticks. Each step is optional and logged if not permitted."""

import ctypes
import errno
import fcntl
import gc
import math
import os
import re
import signal
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

import numpy as np

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_PDEATHSIG = 1


def settle() -> None:
    """Collect garbage once, exempt all existing objects from later collections, and disable automatic collection."""
    gc.collect()
    gc.freeze()
    gc.disable()


def collect() -> None:
    """Collect garbage created since ``settle``; call between ticks."""
    gc.collect()


def release() -> None:
    """Collect frozen objects too, such as the ROS context, whose thread must end before the process."""
    gc.unfreeze()
    gc.collect()


_done: set[str] = set()  #: Completed steps of this process; several nodes of a process request the same steps


def use_fifo(priority: int, log: Callable[[str], object], inherited: bool = True) -> bool:
    """Schedule all threads with SCHED_FIFO at ``priority`` 1 to 99; 0: no change. Logs and returns the outcome.

    Later processes and threads inherit this priority if ``inherited``, else they have ordinary priority.
    """
    if priority <= 0 or f"fifo {priority}" in _done:
        return priority > 0
    policy = os.SCHED_FIFO | (0 if inherited else os.SCHED_RESET_ON_FORK)
    try:
        each_thread(lambda thread: os.sched_setscheduler(thread, policy, os.sched_param(priority)))
    except OSError as error:
        log(f"SCHED_FIFO {priority} not permitted ({error.strerror}): scheduled with ordinary priority")
        return False
    _done.add(f"fifo {priority}")
    log(f"SCHED_FIFO priority {priority}")
    return True


def each_thread(apply: Callable[[int], object]) -> None:
    """Call ``apply`` with the id of every thread of this process."""
    for task in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):  # the thread has just ended
            apply(int(task.name))


def lock_memory(log: Callable[[str], object]) -> bool:
    """Lock the pages of this process in memory on first use; logs and returns the outcome."""
    if "locked" in _done:
        return True
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0:
        _done.add("locked")
        log("memory is locked")
        return True
    log(f"locking memory not permitted ({os.strerror(ctypes.get_errno() or errno.EPERM)})")
    return False


#: Kernel's folder of a core; the process that has taken the core locks it until it ends
_CORE = "/sys/devices/system/cpu/cpu{}"


def take_core(log: Callable[[str], object]) -> bool:
    """Pin all threads of this process to one core that no other process of any graph has taken.

    The thread of the laws then runs on the core of the middleware's thread, with warm caches. Waking a thread on a
    sleeping core costs more than the rest of the hand-over. If there are more such processes than cores, the kernel
    places the last ones. Use for real-time processes only, because other work on the core delays an ordinary process,
    and only on a machine with little load: the kernel reserves a share of each core for ordinary processes, up to 50 ms
    at a time, and a pinned process cannot move to another core. Logs the outcome and returns whether a core was taken.
    """
    if "core" in _done:
        return True
    cores = os.sched_getaffinity(0)
    for core in best_first(cores) if len(cores) > 1 else []:
        try:
            lock = os.open(_CORE.format(core), os.O_RDONLY)
        except OSError:
            continue
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(lock)
            continue
        if pin_to([core], log):
            _done.add("core")  # the lock stays open until the process ends
            return True
        os.close(lock)
    log("no free core for this process alone: scheduled on any core")
    return False


def best_first(cores: Iterable[int]) -> list[int]:
    """Sort cores: first hardware threads before second ones, fast before slow, last index first (0 gets interrupts)."""

    def rank(core: int) -> tuple[bool, int, int]:
        siblings = re.match(r"\d+", _about(core, "topology/thread_siblings_list"))
        speed = _about(core, "cpu_capacity") or _about(core, "cpufreq/cpuinfo_max_freq") or "0"
        return siblings is not None and int(siblings[0]) != core, -int(speed), -core

    return sorted(cores, key=rank)


def _about(core: int, file: str) -> str:
    try:
        return (Path(_CORE.format(core)) / file).read_text(encoding="ascii").strip()
    except OSError:
        return ""


_cores: set[int] = set()  #: Allowed cores of this process before pinning; empty if not pinned


def be_ordinary() -> None:
    """Schedule only the calling thread with ordinary priority, on any core."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if _cores:
        os.sched_setaffinity(0, _cores)


def pin_to(cores: list[int], log: Callable[[str], object]) -> bool:
    """Run this process on the given cores only; logs and returns the outcome."""
    _cores.update(os.sched_getaffinity(0))
    try:
        each_thread(lambda thread: os.sched_setaffinity(thread, cores))
    except OSError as error:
        log(f"cores {cores} not available ({error.strerror})")
        return False
    log(f"on cores {cores}")
    return True


def die_with_parent() -> None:
    """Request SIGTERM from the kernel when the parent process dies; no effect if not supported."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


class _SigEvent(ctypes.Structure):
    """``struct sigevent`` of glibc: a timer calls ``function`` with ``value`` in a thread."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signo", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("padding", ctypes.c_byte * 40),
    )


_SIGEV_THREAD, _CLOCK_MONOTONIC = 2, 1


def end_within(seconds: int, code: int) -> Callable[[], object]:
    """End this process with exit code ``code`` after a time [s], even if it is blocked; returns a cancel function.

    Threads of Fast DDS 2.14 can deadlock during the removal of a writer while holding Python's interpreter lock.
    Therefore timer and thread are those of the C library.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    event = _SigEvent(value=code, notify=_SIGEV_THREAD, function=ctypes.cast(libc._exit, ctypes.c_void_p).value)
    timer, times = ctypes.c_void_p(), (ctypes.c_long * 4)(0, 0, seconds, 0)
    if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)):
        raise OSError(ctypes.get_errno(), "timer_create")
    libc.timer_settime(timer, 0, times, None)
    return lambda: libc.timer_delete(timer)


WINDOW = 4096  #: Number of ticks in the statistics: about four seconds at 1 kHz
MEDIAN, TAIL = "tick p50 [us]", "tick p99 [us]"  #: Keys in the diagnostics


class TickTimer:
    """Measures the duration of ticks; a context manager around each tick."""

    def __init__(self) -> None:
        self._durations = np.zeros(WINDOW)  # [us]
        self._count = 0
        self._begin = 0

    def __enter__(self) -> None:
        self._begin = time.perf_counter_ns()

    def __exit__(self, *error: object) -> None:
        self._durations[self._count % WINDOW] = 1e-3 * (time.perf_counter_ns() - self._begin)
        self._count += 1

    @property
    def last(self) -> float:
        """Duration of the last tick [s]; 0 before the first."""
        return 1e-6 * float(self._durations[(self._count - 1) % WINDOW])

    def values(self) -> dict[str, str]:
        """Median and 99th percentile of the last ticks [us], for diagnostics; empty before the first tick."""
        p50, p99 = self.percentiles()
        return {MEDIAN: f"{p50:.0f}", TAIL: f"{p99:.0f}"} if self._count else {}

    def percentiles(self) -> tuple[float, float]:
        """Median and 99th percentile of the last ticks [us]; NaN before the first tick."""
        if self._count == 0:
            return math.nan, math.nan
        p50, p99 = np.percentile(self._durations[: min(self._count, WINDOW)], [50.0, 99.0])
        return float(p50), float(p99)
