"""Processor and memory use of processes, and the real-time properties of the machine."""

import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from benchmarks.core.provenance import usable_cores
from bridge.analysis.processor import cpu_time
from models.errors import PoiseError


class Unavailable(PoiseError):
    """The machine lacks a requirement of a case; the case is reported as ``NOT_RUN``."""


@dataclass(frozen=True, slots=True)
class Use:
    """Use of a process: share of one core ``cpu`` [-], resident ``memory`` at the end [MiB]."""

    cpu: float
    memory: float


class UseMeter:
    """Measures the use of processes (pid by name) from construction to reading."""

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = dict(pids)
        self._begin = time.monotonic()
        self._before = {name: cpu_time(pid) for name, pid in self._pids.items()}

    def read(self) -> dict[str, Use]:
        """Return the use of each process since construction; processes that have ended are omitted."""
        span = max(time.monotonic() - self._begin, 1e-9)
        found = {}
        for name, pid in self._pids.items():
            try:
                found[name] = Use((cpu_time(pid) - self._before[name]) / span, resident(pid))
            except OSError:
                continue
        return found


def resident(pid: int | str) -> float:
    """Return the resident memory of a process [MiB]; ``self`` for this process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 2.0**20


BUFFER_MIN = 1 << 20  # sufficient socket receive buffer for a recording, a camera or several robots [B]
CORES_MIN = 2  # bridge and control run at the same time; with fewer cores they wait for each other

#: Program that tests the permissions in a separate process
_PERMITTED = """
import sys
from models.nodes import realtime
print(int(realtime.use_fifo(40, lambda text: None)), int(realtime.lock_memory(lambda text: None)))
"""


@dataclass(frozen=True, slots=True)
class Machine:
    """Properties of a machine that affect real-time operation."""

    cores: int  #: Usable by this process
    governor: str  #: Frequency governor of the first core; empty if not visible, as in a virtual machine
    fifo: bool  #: Whether SCHED_FIFO is permitted
    locked: bool  #: Whether memory may be locked
    isolated: str  #: Cores isolated by the kernel, in its notation; empty for none
    realtime_kernel: bool  #: Whether the kernel is fully preemptible
    throttled: float  #: Share of a period that all real-time processes together may use [-]
    receive_buffer: int  #: Maximum receive buffer of a socket [B]; 0 if not visible


def read_machine(root: Path = Path("/")) -> Machine:
    """Inspect this machine, with ``sys`` and ``proc`` below ``root``; an unreadable value counts as absent."""

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
    found = subprocess.run([sys.executable, "-c", _PERMITTED], capture_output=True, text=True, check=False)
    words = found.stdout.split()
    return (words[0] == "1", words[1] == "1") if len(words) == 2 else (False, False)


def advice(machine: Machine) -> list[str]:
    """Return recommended changes to the machine, most effective first; empty if there are none."""
    found = []
    if not machine.fifo:
        found.append("permit SCHED_FIFO: '@GROUP - rtprio 50' in /etc/security/limits.d, or CAP_SYS_NICE")
    if not machine.locked:
        found.append("permit locked memory: '@GROUP - memlock unlimited' in /etc/security/limits.d")
    if machine.cores < CORES_MIN:
        found.append(f"cores: {machine.cores}; driver and laws wait for each other: provide {CORES_MIN} or more")
    if machine.governor and machine.governor != "performance":
        found.append(f"CPU governor '{machine.governor}': set 'performance' (cpupower frequency-set -g performance)")
    if not machine.isolated and machine.cores > CORES_MIN:
        found.append("no isolated core: boot with isolcpus=N and set realtime.cores of the control nodes to [N]")
    if not machine.realtime_kernel:
        found.append("the kernel is not PREEMPT_RT: latencies of some ms remain under load")
    if machine.fifo and machine.throttled < 1.0:
        share = f"{100.0 * machine.throttled:.0f} %"
        found.append(f"real-time processes get {share} of each core: use SCHED_FIFO for one graph only")
    if 0 < machine.receive_buffer < BUFFER_MIN:
        found.append(
            f"net.core.rmem_max is {machine.receive_buffer} B: recorders lose samples; "
            f"sysctl -w net.core.rmem_max={BUFFER_MIN}"
        )
    return found
