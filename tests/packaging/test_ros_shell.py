"""The session of a user of ROS 2 (``python -m tests.ros_shell``), and that it fails when a step does."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from models.errors import PoiseError
from models.nodes.interface_build import require_tools
from tests.ros_shell.shell import Shell
from tests.ros_shell.steps import Step

LISTENER = "'import time; print(1, flush=True); time.sleep(60)'"


@pytest.fixture
def python(tmp_path: Path) -> Shell:
    """A shell whose ``ros2`` is Python."""
    return Shell([sys.executable, "-c"], os.environ, tmp_path)


def test_a_step_that_does_not_show_what_it_has_to_is_reported(
    python: Shell, capsys: pytest.CaptureFixture[str]
) -> None:
    assert python.do(Step("'print(12)'", (r"^\d+$",)))
    assert not python.do(Step("'print(12)'", (r"\d", "thirteen")))
    assert python.failed == ["'print(12)'"]
    assert "FAILED: not shown: thirteen" in capsys.readouterr().out


def test_a_step_that_does_not_end_fails(python: Shell) -> None:
    assert not python.do(Step(LISTENER, ("1",)), timeout=1.0)


def test_ctrl_c_ends_a_step_that_only_listens(python: Shell) -> None:
    assert python.do(Step(LISTENER, ("1",), stop=True))


def test_a_step_in_between_counts(python: Shell) -> None:
    assert python.do(Step(LISTENER, ("1",), Step("'print(2)'", ("2",)), stop=True))
    assert not python.do(Step(LISTENER, ("1",), Step("'print(2)'", ("3",)), stop=True))


def test_what_is_new_is_looked_for_again(python: Shell, tmp_path: Path) -> None:
    look = f'\'import pathlib; print(pathlib.Path("{tmp_path}/new").exists()); pathlib.Path("{tmp_path}/new").touch()\''
    assert python.do(Step(look, ("True",), again=True))
    (tmp_path / "new").unlink()
    assert not python.do(Step(look, ("True",)))
    assert not python.do(Step("'print(1)'", ("2",), again=True), timeout=0.5)


def test_a_checkout_is_not_an_installation(root: Path) -> None:
    command = [sys.executable, "-m", "tests.ros_shell", "--prefix", sys.prefix]  # an editable install
    result = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False, timeout=60)
    assert result.returncode == 1
    assert "poise is not installed in" in result.stderr


@pytest.mark.ros
@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("", "required: COMMAND"),
        ("fly", "invalid choice: 'fly'"),
        ("topic pub /x", "required: kind"),
        ("topic pub -r nan /x std_msgs/msg/String", "invalid number of at least 0.001 value: 'nan'"),
        ("topic pub /x String", "'String' is no type of an interface, such as std_msgs/msg/String"),
        ("topic pub /x std_msgs/msg/String '{daata: 1}'", "no field 'daata'; its fields are {data: string}"),
        ("topic pub /x std_msgs/msg/String '{data: ['", "is no YAML"),
        ("topic pub /x std_msgs/msg/String hello", "'hello' does not name fields"),
        ("topic pub /x std_msgs/msg/Bool '{data: 7}'", "data: 7 is no boolean"),
        ("topic pub /x geometry_msgs/msg/Twist '{linear: {x: fast}}'", "x: 'fast' is no double"),
        ("topic pub /x trajectory_msgs/msg/JointTrajectory '{points: [3]}'", "3 does not name fields"),
        ("topic pub 'x y' std_msgs/msg/String", "Invalid topic name"),
        ("topic info /nothing", "Unknown topic '/nothing': ros2 topic list"),
        ("service call /x std_srvs/srv/Trigger '{a: 1}'", "no field 'a'"),
        ("pkg prefix nothing", "Package 'nothing' not found"),
        ("interface show nothing/msg/X", "Package 'nothing' not found"),
    ],
)
def test_what_is_wrong_with_a_command_is_one_line(root: Path, ros_domain_id: int, line: str, error: str) -> None:
    command = [sys.executable, str(root / "tests/ros_shell/ros2.py"), *shlex.split(line)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert result.returncode in (1, 2) and not result.stdout
    assert error in result.stderr.splitlines()[-1], result.stderr


@pytest.mark.parametrize("line", ["--help", "topic pub --help", "action send_goal --help"])
def test_help_is_no_error(root: Path, line: str) -> None:
    command = [sys.executable, str(root / "tests/ros_shell/ros2.py"), *line.split()]
    assert subprocess.run(command, capture_output=True, check=False, timeout=60).returncode == 0


@pytest.mark.slow
@pytest.mark.ros
def test_every_step_of_a_session_works_on_what_is_installed(root: Path) -> None:
    pytest.importorskip("hatchling", reason="installing needs hatchling")
    try:
        require_tools()
    except PoiseError as error:
        pytest.skip(str(error))
    session = [sys.executable, "-m", "tests.ros_shell"]
    result = subprocess.run(session, cwd=root, capture_output=True, text=True, check=False, timeout=900)
    assert result.returncode == 0, result.stdout + result.stderr
