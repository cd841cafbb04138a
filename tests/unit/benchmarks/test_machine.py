"""The verdict on a machine: what is seen of it, and the advice."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.core.machine import BUFFER_MIN, Machine, UseMeter, advice, cpu_time, read_machine, resident

IDEAL = Machine(
    cores=4,
    governor="performance",
    fifo=True,
    locked=True,
    isolated="3",
    realtime_kernel=True,
    throttled=1.0,
    receive_buffer=8 * BUFFER_MIN,
)


def test_nothing_is_said_of_a_machine_that_is_well_set_up() -> None:
    assert advice(IDEAL) == []
    assert advice(replace(IDEAL, governor="", receive_buffer=0)) == []  # not to be seen


@pytest.mark.parametrize(
    ("fault", "word"),
    [
        ({"fifo": False}, "SCHED_FIFO"),
        ({"locked": False}, "memlock"),
        ({"cores": 1}, "cores: 1"),
        ({"governor": "powersave"}, "'powersave'"),
        ({"isolated": ""}, "isolcpus"),
        ({"realtime_kernel": False}, "PREEMPT_RT"),
        ({"throttled": 0.95}, "95 %"),
        ({"receive_buffer": 212992}, "212992 B"),
    ],
)
def test_every_lack_is_named(fault: dict[str, object], word: str) -> None:
    found = advice(replace(IDEAL, **fault))  # type: ignore[arg-type]
    assert len(found) == 1 and word in found[0]


def test_a_machine_is_read_from_its_files(tmp_path: Path) -> None:
    texts = {
        "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "schedutil\n",
        "sys/devices/system/cpu/isolated": "2-3\n",
        "sys/kernel/realtime": "1\n",
        "proc/sys/kernel/sched_rt_runtime_us": "950000\n",
        "proc/sys/kernel/sched_rt_period_us": "1000000\n",
        "proc/sys/net/core/rmem_max": "212992\n",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    machine = read_machine(tmp_path)
    assert (machine.governor, machine.isolated, machine.realtime_kernel) == ("schedutil", "2-3", True)
    assert (machine.throttled, machine.receive_buffer) == (0.95, 212992)
    (tmp_path / "proc/sys/kernel/sched_rt_runtime_us").write_text("-1\n")
    assert read_machine(tmp_path).throttled == 1.0


def test_a_machine_without_these_files_is_read_too(tmp_path: Path) -> None:
    machine = read_machine(tmp_path)
    assert (machine.governor, machine.isolated, machine.throttled, machine.receive_buffer) == ("", "", 1.0, 0)


def test_use_is_that_of_the_process_and_dead_ones_are_left_out() -> None:
    import os
    import subprocess
    import sys

    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    meter = UseMeter({"self": os.getpid(), "child": child.pid})
    before = cpu_time(os.getpid())
    while cpu_time(os.getpid()) < before + 0.05:
        pass
    child.communicate(b"\n")
    found = meter.read()
    assert set(found) == {"self"}
    assert found["self"].cpu > 0.0
    assert found["self"].memory == pytest.approx(resident("self"), rel=0.2)
