"""What a process can do to keep its deadlines, each step optional and said in the log when not permitted."""

from __future__ import annotations

import ctypes
import errno
import gc
import os
import signal
from collections.abc import Callable
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
        for task in Path("/proc/self/task").iterdir():
            os.sched_setscheduler(int(task.name), os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        log(f"SCHED_FIFO {priority} not permitted ({error.strerror}): scheduled like any other process")
        return False
    _done.add(f"fifo {priority}")
    log(f"SCHED_FIFO priority {priority}")
    return True


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
    try:
        for task in Path("/proc/self/task").iterdir():
            os.sched_setaffinity(int(task.name), cores)
    except OSError as error:
        log(f"cores {cores} not available ({error.strerror})")
        return False
    log(f"on cores {cores}")
    return True


def die_with_parent() -> None:
    """Have the kernel end this process when the one that started it dies; no effect where the kernel cannot."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
