"""A shifted wall clock: for the processes that are started with it alone, and nothing else of theirs is shifted."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.graph import graph_kinds
from benchmarks.graph.graph_kinds import WallClock
from models.errors import PoiseError

ASK = """
import sys, threading, time
for line in sys.stdin:
    begin = time.monotonic()
    threading.Event().wait(0.05)
    print(time.time(), begin, time.monotonic() - begin, flush=True)
"""

HOUR = 3600.0


@pytest.fixture
def wall_clock(tmp_path: Path) -> WallClock:
    return WallClock(tmp_path)


def test_it_jumps_while_the_process_runs_and_the_monotonic_clock_does_not(wall_clock: WallClock) -> None:
    variables = os.environ | wall_clock.variables
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", ASK], env=variables, **pipes) as child:  # type: ignore[call-overload]
        for shift in (0.0, HOUR, -HOUR, 0.0):
            wall_clock.shift(shift)
            print("now", file=child.stdin, flush=True)
            wall, steady, waited = map(float, child.stdout.readline().split())
            assert abs(wall - time.time() - shift) < 5.0
            assert abs(steady - time.monotonic()) < 5.0
            assert 0.04 < waited < 5.0
        child.stdin.close()


def test_without_libfaketime_it_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_kinds, "find_spec", lambda name: None)
    with pytest.raises(PoiseError, match="libfaketime is not installed"):
        WallClock(tmp_path)
