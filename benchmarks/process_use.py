"""What processes take of processor and memory, as the kernel counts it."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

_UTIME = 11
"""Field of user time in ``/proc/PID/stat`` after the process' name, which may hold spaces; system time follows."""

_TICK = 1.0 / os.sysconf("SC_CLK_TCK")
"""Length of the kernel's tick of these times [s]."""


@dataclass(frozen=True, slots=True)
class Use:
    """What a process takes.

    Attributes:
        cpu: Share of one core [-].
        memory: Resident memory at the end [MiB].
    """

    cpu: float
    memory: float


class UseMeter:
    """Measures from its making until it is read.

    Args:
        pids: Processes by any name.
    """

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = dict(pids)
        self._begin = time.monotonic()
        self._before = {name: cpu_time(pid) for name, pid in self._pids.items()}

    def read(self) -> dict[str, Use]:
        """Use of each process since; those that have ended are left out."""
        span = max(time.monotonic() - self._begin, 1e-9)
        found = {}
        for name, pid in self._pids.items():
            try:
                found[name] = Use((cpu_time(pid) - self._before[name]) / span, resident(pid))
            except OSError:
                continue
        return found


def cpu_time(pid: int) -> float:
    """User and system time that a process and its threads have taken so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[_UTIME]) + int(fields[_UTIME + 1])) * _TICK


def resident(pid: int | str) -> float:
    """Resident memory of a process [MiB]; ``self`` for this one."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2.0**20
