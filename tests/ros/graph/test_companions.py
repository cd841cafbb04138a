"""Processes beside a measured graph end with the command that started them, even if it is killed."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.ros

GIVE_UP = 10.0  # [s]

COMMAND = """
import sys, time
from pathlib import Path
from benchmarks.graph.graph_run import latency_config
from benchmarks.graph.graph_run import companions

with companions(latency_config().scenarios["stress"], int(sys.argv[1]), Path(sys.argv[2])) as started:
    print(*started.values(), flush=True)
    time.sleep(60.0)
"""


@pytest.mark.long
def test_a_killed_command_leaves_no_companion_behind(tmp_path: Path) -> None:
    words = [sys.executable, "-c", COMMAND, "77", str(tmp_path)]  # nothing speaks in that domain
    command = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert command.stdout is not None
    with command.stdout:
        pids = [int(pid) for pid in command.stdout.readline().split()]
    command.kill()
    command.wait()
    assert pids
    give_up = time.monotonic() + GIVE_UP
    while (left := [pid for pid in pids if Path(f"/proc/{pid}").exists()]) and time.monotonic() < give_up:
        time.sleep(0.05)
    assert not left
