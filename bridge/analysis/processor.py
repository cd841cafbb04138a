"""Processor time of processes."""

import os
from pathlib import Path

#: Index of the user time in ``/proc/PID/stat`` after the process name, which may have spaces; system time is next
_UTIME = 11
_TICK = 1.0 / os.sysconf("SC_CLK_TCK")  # unit of these times [s]


def cpu_time(pid: int) -> float:
    """User and system time of a process and its threads so far [s]; ``OSError`` when the process has ended."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[_UTIME]) + int(fields[_UTIME + 1])) * _TICK
