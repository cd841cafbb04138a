"""What a process can do to keep its deadlines, each step optional and said in the log when not permitted."""

from __future__ import annotations

import ctypes
import errno
import fcntl
import gc
import os
import re
import signal
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_PDEATHSIG = 1


def settle() -> None:
    """Collect garbage once, exempt all that lives from later collections, and turn automatic collection off."""
    gc.collect()
    gc.freeze()
    gc.disable()


def collect() -> None:
    """Collect what came since ``settle``; to be called between ticks."""
    gc.collect()


def release() -> None:
    """Collect what has been frozen too: the ROS context, and with it the middleware's thread that watches the graph.

    That thread must have ended when the process does: the middleware then destroys what the thread reads.
    """
    gc.unfreeze()
    gc.collect()


_done: set[str] = set()
"""Steps this process has taken; nodes that share it ask for the same ones."""


def use_fifo(priority: int, log: Callable[[str], object]) -> bool:
    """Schedule every thread of this process first-in first-out.

    Args:
        priority: 1 (lowest) to 99; 0 leaves the scheduling alone.
        log: Takes the sentence that says what happened.

    Returns:
        Whether it is in force.
    """
    if priority <= 0 or f"fifo {priority}" in _done:
        return priority > 0
    try:
        each_thread(lambda thread: os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority)))
    except OSError as error:
        log(f"SCHED_FIFO {priority} not permitted ({error.strerror}): scheduled like any other process")
        return False
    _done.add(f"fifo {priority}")
    log(f"SCHED_FIFO priority {priority}")
    return True


def each_thread(apply: Callable[[int], object]) -> None:
    """Do something to every thread of this process that still lives."""
    for task in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):  # it has just ended
            apply(int(task.name))


def lock_memory(log: Callable[[str], object]) -> bool:
    """Keep the pages of this process in memory from their first use on.

    Args:
        log: Takes the sentence that says what happened.

    Returns:
        Whether it is in force.
    """
    if "locked" in _done:
        return True
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0:
        _done.add("locked")
        log("memory is locked")
        return True
    log(f"locking memory not permitted ({os.strerror(ctypes.get_errno() or errno.EPERM)})")
    return False


_CORE = "/sys/devices/system/cpu/cpu{}"
"""Where the kernel tells of a core. Locked by the process that has taken it, until that ends."""


def take_core(log: Callable[[str], object]) -> bool:
    """Keep every thread of this process on one core that no other process of any graph has taken.

    What the middleware's thread receives, the thread of the laws then goes on with where it is, in the same caches;
    waking a thread on a core that sleeps costs more than the rest of the hand-over. Where processes that take a core
    outnumber the cores, the kernel goes on placing the last ones. Only for processes scheduled before all others:
    whatever else runs on that core would delay any other. And only where little else runs: the kernel keeps a share of
    each core for ordinary processes, up to 50 ms at a time, and who is bound to the core cannot evade.

    Args:
        log: Takes the sentence that says what happened.

    Returns:
        Whether it has one.
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
            _done.add("core")  # the lock stays open as long as the process lives
            return True
        os.close(lock)
    log("no core is free for this process alone: placed by the kernel")
    return False


def best_first(cores: Iterable[int]) -> list[int]:
    """Cores in the order in which they suit a tick.

    One thread of each before its second one, fast ones before slow ones, and then the last ones before the first, to
    which interrupts mostly go.
    """

    def rank(core: int) -> tuple[bool, int, int]:
        siblings = re.match(r"\d+", _about(core, "topology/thread_siblings_list"))
        speed = _about(core, "cpu_capacity") or _about(core, "cpufreq/cpuinfo_max_freq") or "0"
        return siblings is not None and int(siblings[0]) != core, -int(speed), -core

    return sorted(cores, key=rank)


def _about(core: int, file: str) -> str:
    """What the kernel says of a core; empty where it says nothing."""
    try:
        return (Path(_CORE.format(core)) / file).read_text(encoding="ascii").strip()
    except OSError:
        return ""


_cores: set[int] = set()
"""Where this process was allowed to run before it was pinned; empty while it is not."""


def be_ordinary() -> None:
    """Schedule the calling thread, and no other, like those of any process that has nothing to do with the tick."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if _cores:
        os.sched_setaffinity(0, _cores)


def pin_to(cores: list[int], log: Callable[[str], object]) -> bool:
    """Run this process on the given cores only; an empty list leaves it to the kernel.

    Args:
        cores: Core numbers.
        log: Takes the sentence that says what happened.

    Returns:
        Whether it is in force.
    """
    if not cores:
        return False
    _cores.update(os.sched_getaffinity(0))
    try:
        each_thread(lambda thread: os.sched_setaffinity(thread, cores))
    except OSError as error:
        log(f"cores {cores} not available ({error.strerror})")
        return False
    log(f"on cores {cores}")
    return True


def die_with_parent() -> None:
    """Have the kernel end this process when the one that started it dies; no effect where the kernel cannot."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
