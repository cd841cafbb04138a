"""Processes of the tick have a core each, as long as there are cores."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from models.nodes import realtime

TAKER = """
import os, sys, threading
from models.nodes import realtime
realtime._CORE = sys.argv[1]
wait = threading.Event()
threading.Thread(target=wait.wait).start()
said = []
taken = realtime.take_core(said.append)
print(taken, [sorted(os.sched_getaffinity(int(task))) for task in os.listdir("/proc/self/task")])
print(realtime.take_core(said.append), len(said), flush=True)
sys.stdin.read()
wait.set()
"""
"""Takes a core twice, says what it has, and keeps it until its input ends."""

ALLOWED = sorted(os.sched_getaffinity(0))

pytestmark = pytest.mark.skipif(len(ALLOWED) < 2, reason="one core")


def _take(pattern: str) -> tuple[subprocess.Popen[str], list[str]]:
    process = subprocess.Popen(
        [sys.executable, "-c", TAKER, pattern], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    return process, [process.stdout.readline().strip() for _ in range(2)]


def test_each_process_has_a_core_of_its_own_until_it_ends(tmp_path: Path) -> None:
    one, other = ALLOWED[-1], ALLOWED[0]
    for core in (one, other):
        (tmp_path / f"cpu{core}").mkdir()
    pattern = str(tmp_path / "cpu{}")
    first, said = _take(pattern)
    assert said == [f"True [[{one}], [{one}]]", "True 1"]
    second, said = _take(pattern)
    assert said == [f"True [[{other}], [{other}]]", "True 1"]
    third, said = _take(pattern)
    assert said == [f"False [{ALLOWED}, {ALLOWED}]", "False 2"]
    first.communicate()
    fourth, said = _take(pattern)
    assert said[0].startswith(f"True [[{one}]")
    for process in (second, third, fourth):
        process.communicate()
        assert process.returncode == 0


def test_the_second_thread_of_a_core_and_slow_cores_come_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "_CORE", str(tmp_path / "cpu{}"))
    said = {0: ("0-1", 900), 1: ("0-1", 900), 2: ("2,5", 1000), 3: ("3", 400), 4: ("4", 400), 5: ("2,5", 1000)}
    for core, (siblings, speed) in said.items():
        (tmp_path / f"cpu{core}" / "topology").mkdir(parents=True)
        (tmp_path / f"cpu{core}" / "topology/thread_siblings_list").write_text(siblings + "\n")
        (tmp_path / f"cpu{core}" / "cpu_capacity").write_text(f"{speed}\n")
    assert realtime.best_first(range(6)) == [2, 0, 4, 3, 5, 1]
    assert realtime.best_first([7, 9, 8]) == [9, 8, 7]  # nothing is known of them


def test_a_thread_that_has_nothing_to_do_with_the_tick_may_run_anywhere_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "_cores", set())
    found: list[set[int]] = []

    def run() -> None:
        realtime.be_ordinary()
        found.append(os.sched_getaffinity(0))

    try:
        assert realtime.pin_to([ALLOWED[0]], lambda text: None)
        thread = threading.Thread(target=run)
        thread.start()
        thread.join()
        assert found == [set(ALLOWED)] and os.sched_getaffinity(0) == {ALLOWED[0]}
    finally:
        realtime.pin_to(ALLOWED, lambda text: None)
