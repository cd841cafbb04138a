"""The session of a user of ROS 2 (``python -m tests.ros_shell``), and that it fails when a step does."""

import os
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
