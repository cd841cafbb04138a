"""Processor time of processes."""

import os
from pathlib import Path

#: Field of user time in ``/proc/PID/stat`` after the process' name, which may hold spaces; system time follows
_UTIME = 11
_TICK = 1.0 / os.sysconf("SC_CLK_TCK")  # length of the kernel's tick of these times [s]


def cpu_time(pid: int) -> float:
    """User and system time that a process and its threads have taken so far [s]; ``OSError`` where it has ended."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[_UTIME]) + int(fields[_UTIME + 1])) * _TICK
