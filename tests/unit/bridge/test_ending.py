"""The end of a real robot's graph: the order of its steps, what is not lowered, and what Ctrl-C interrupts."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from types import TracebackType
from typing import ClassVar

import pytest

pytest.importorskip("rclpy")

from bridge.launch.ending import EndConfig, lower
from bridge.launch.run import run_until_signal
from models.config import default_config
from models.errors import PoiseError

pytestmark = pytest.mark.ros


class Robot:
    """A graph whose modes follow its commands."""

    exit_codes: ClassVar[dict[str, int | None]] = {}
    modes: ClassVar[dict[str, tuple[str, ...]]] = {"stop": ("stand",), "crouch": ("motion", "stand")}

    damps = True  #: Whether it is damped after it has sunk

    def __init__(self, mode: str, refuses: str = "") -> None:
        self.mode, self.driver_state, self._refuses = mode, "active", refuses
        self.refusal = ""
        self.done: list[str] = []
        self._next: list[str] = []

    def __enter__(self) -> "Robot":
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.stop()

    def send(self, text: str) -> None:
        self.done.append(text)
        self._next = [] if text == self._refuses else list(self.modes[text])
        self.refusal = "a hold" if text == self._refuses == "crouch" else ""

    def call(self, service: str) -> tuple[bool, str]:
        self.done.append(service)
        self._next = ["relaxing", "damped"] if self.damps else []
        return service != self._refuses, "no"

    def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        while not condition():
            if not self._next:
                raise PoiseError(f"not {what}")
            if self.done[-1] == "start/relax":
                self.driver_state = self._next.pop(0)
            else:
                self.mode = self._next.pop(0)

    def spin(self, duration: float) -> None:
        self.done.append("spin")

    def stop(self) -> None:
        if self.done[-1:] != ["stop processes"]:
            self.done.append("stop processes")


@pytest.fixture
def config() -> EndConfig:
    return default_config(EndConfig, "bridge", "ending")


@pytest.mark.parametrize("mode", ["stand", "walk", "motion"])
def test_a_robot_that_stands_or_moves_is_lowered(config: EndConfig, mode: str) -> None:
    robot = Robot(mode)
    lower(robot, config)
    assert robot.done == ["stop"] * (mode != "stand") + [config.motion, "start/relax", "spin"]


@pytest.mark.parametrize("mode", ["", "off", "damp"])
def test_any_other_robot_is_not_lowered(config: EndConfig, mode: str) -> None:
    robot = Robot(mode)
    with pytest.raises(PoiseError, match="it is damped"):
        lower(robot, config)
    assert not robot.done


@pytest.mark.parametrize(("step", "reason"), [("stop", "not standing"), ("crouch", "a hold"), ("start/relax", "no")])
def test_a_refused_step_ends_it(config: EndConfig, step: str, reason: str) -> None:
    robot = Robot("walk", refuses=step)
    with pytest.raises(PoiseError, match=reason):
        lower(robot, config)
    assert robot.done[-1] == step


def test_a_refusal_of_the_planner_ends_it_with_its_reason(config: EndConfig) -> None:
    class Refused(Robot):
        def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
            super().wait_for(condition, timeout, what)
            if self.mode == "motion":  # which the supervisor enters before it is planned
                self.refusal = "out of reach"

    robot = Refused("stand")
    with pytest.raises(PoiseError, match="out of reach"):
        lower(robot, config)
    assert robot.done == ["crouch"]


@pytest.mark.parametrize("modes", [("walk",), ("motion", "walk"), ("damp",), ("motion", "damp")])
def test_a_robot_that_begins_to_walk_or_is_damped_meanwhile_does_not_relax(
    config: EndConfig, modes: tuple[str, ...]
) -> None:
    robot = Robot("walk")
    robot.modes = Robot.modes | {"crouch": modes}  # type: ignore[misc]
    with pytest.raises(PoiseError, match=f"not lowered from mode '{modes[-1]}'"):
        lower(robot, config)
    assert robot.done == ["stop", "crouch"]


def test_the_processes_end_only_after_damping(config: EndConfig) -> None:
    robot = Robot("stand")
    robot.damps = False
    with pytest.raises(PoiseError, match="not damped"):
        lower(robot, config)
    assert "spin" not in robot.done


def interrupted(number: int, at_end: bool = True, again: bool = False) -> list[str]:
    """What is done when a signal arrives while the graph runs, and again while it ends."""
    robot = Robot("stand")

    def spin(duration: float) -> None:
        assert callable(signal.getsignal(signal.SIGTSTP))  # a test process that is suspended does not fail
        os.kill(os.getpid(), signal.SIGTSTP)
        os.kill(os.getpid(), number)

    def end(graph: Robot) -> None:
        graph.done.append("begin")
        if again:
            os.kill(os.getpid(), signal.SIGINT)
        graph.done.append("end")

    robot.spin = spin  # type: ignore[method-assign]
    code = run_until_signal(lambda say: robot, "g1", duration=None, end=end if at_end else None)  # type: ignore[arg-type, return-value]
    assert code == 0 and signal.getsignal(signal.SIGTSTP) is signal.SIG_DFL
    return robot.done


def test_a_second_interrupt_and_a_termination_end_the_processes_at_once() -> None:
    assert interrupted(signal.SIGINT) == ["begin", "end", "stop processes"]
    assert interrupted(signal.SIGINT, again=True) == ["begin", "stop processes"]
    assert interrupted(signal.SIGTERM) == ["stop processes"]
    assert interrupted(signal.SIGINT, at_end=False) == ["stop processes"]


TERMINAL = """
import fcntl, termios
from bridge.launch.run import run_until_signal
from models.errors import PoiseError

def make(say):
    report()
    raise PoiseError("no graph")

def report():
    print(bool(termios.tcgetattr(2)[0] & termios.IXON))

fcntl.ioctl(2, termios.TIOCSCTTY, 0)
report()
run_until_signal(make, "g1", duration=None)
report()
"""


def test_no_output_of_the_graph_is_stopped_by_the_terminal() -> None:
    main, terminal = os.openpty()
    try:
        command = [sys.executable, "-c", TERMINAL]
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=terminal, text=True, start_new_session=True)
    finally:
        os.close(terminal)
        os.close(main)
    assert done.stdout.split() == ["True", "False", "True"]
