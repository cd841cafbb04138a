"""What of a machine decides whether it keeps 1 kHz, and what to change about it."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarks.provenance import usable_cores

BUFFER_MIN = 1 << 20
"""Receive buffer of a socket that a recording, a camera or several robots are well served with [B]."""

CORES_MIN = 2
"""Bridge and laws run at the same time; with fewer they wait for each other."""

_PERMITTED = """
import sys
from models.nodes import realtime
print(int(realtime.use_fifo(40, lambda text: None)), int(realtime.lock_memory(lambda text: None)))
"""
"""Tried in a process of its own, which nothing else is to share."""


@dataclass(frozen=True, slots=True)
class Machine:
    """What decides about real time.

    Attributes:
        cores: That this process may use.
        governor: Of the first core's frequency; empty where none is to be seen, as in a virtual machine.
        fifo: Whether SCHED_FIFO is permitted.
        locked: Whether memory may be locked.
        isolated: Cores that the kernel keeps free, as it names them; empty for none.
        realtime_kernel: Whether the kernel is fully preemptible.
        throttled: Share of a period that real-time processes may take together [-]; 1 for all of it.
        receive_buffer: Largest receive buffer of a socket [B]; 0 where it is not to be seen.
    """

    cores: int
    governor: str
    fifo: bool
    locked: bool
    isolated: str
    realtime_kernel: bool
    throttled: float
    receive_buffer: int


def read_machine(root: Path = Path("/")) -> Machine:
    """Look at this machine; what is not to be seen counts as absent.

    Args:
        root: Under which ``sys`` and ``proc`` lie.
    """

    def text(path: str) -> str:
        try:
            return (root / path).read_text(encoding="ascii").strip()
        except OSError:
            return ""

    def number(path: str) -> int:
        found = text(path)
        return int(found) if found.lstrip("-").isdecimal() else 0

    runtime, period = number("proc/sys/kernel/sched_rt_runtime_us"), number("proc/sys/kernel/sched_rt_period_us")
    fifo, locked = _permitted()
    return Machine(
        cores=usable_cores(),
        governor=text("sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        fifo=fifo,
        locked=locked,
        isolated=text("sys/devices/system/cpu/isolated"),
        realtime_kernel=text("sys/kernel/realtime") == "1",
        throttled=1.0 if runtime < 0 or period <= 0 else runtime / period,
        receive_buffer=number("proc/sys/net/core/rmem_max"),
    )


def _permitted() -> tuple[bool, bool]:
    """Whether SCHED_FIFO and locked memory are permitted, by trying them."""
    found = subprocess.run(
        [sys.executable, "-c", _PERMITTED], capture_output=True, text=True, check=False, env=dict(os.environ)
    )
    words = found.stdout.split()
    return (words[0] == "1", words[1] == "1") if len(words) == 2 else (False, False)


def advice(machine: Machine) -> list[str]:
    """What to change about a machine, most effective first; empty when there is nothing."""
    found = []
    if not machine.fifo:
        found.append("permit SCHED_FIFO: '@GROUP - rtprio 50' in /etc/security/limits.d, or CAP_SYS_NICE")
    if not machine.locked:
        found.append("permit locked memory: '@GROUP - memlock unlimited' in /etc/security/limits.d")
    if machine.cores < CORES_MIN:
        found.append(f"{machine.cores} core: bridge and laws wait for each other; give it {CORES_MIN} at least")
    if machine.governor and machine.governor != "performance":
        found.append(f"CPU governor '{machine.governor}': set 'performance' (cpupower frequency-set -g performance)")
    if not machine.isolated and machine.cores > CORES_MIN:
        found.append("no isolated core: boot with isolcpus=N and set realtime.cores of the control nodes to [N]")
    if not machine.realtime_kernel:
        found.append("the kernel is not PREEMPT_RT: a tail of some ms remains under load")
    if machine.fifo and machine.throttled < 1.0:
        share = f"{100.0 * machine.throttled:.0f} %"
        found.append(f"real-time processes get {share} of each core: of several graphs, one alone may run SCHED_FIFO")
    if 0 < machine.receive_buffer < BUFFER_MIN:
        found.append(
            f"net.core.rmem_max is {machine.receive_buffer} B: recorders lose samples; "
            f"sysctl -w net.core.rmem_max={BUFFER_MIN}"
        )
    return found
