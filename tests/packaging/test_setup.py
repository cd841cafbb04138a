"""`.ci/setup` on machines that lack something: it names what to install, and does nothing when all is there."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

TOOLS = ("bash", "cat", "cut", "cksum", "dirname", "env", "grep", "head", "paste", "rm", "tail", "tr", "uname")

FAKE_PYTHON = """#!/bin/bash
# Stands for Python {version}: answers what .ci/setup asks, and notes its arguments.
case "$*" in
  --version) echo "Python {version}" ;;
  *"import rclpy"*) {rclpy} ;;
  *ensurepip*) {ensurepip} ;;
  *version_info*) {new} ;;
  *base_prefix*) echo "/fake {version}" ;;
  "-m venv"*) mkdir -p .venv/bin; echo "$*" > .venv/created; cp "$0" .venv/bin/python ;;
  "-m pip"*) echo "$*" > .venv/installed ;;
  *"import mujoco, placo, rclpy"*) true ;;
  "-m models.nodes.interface_build") true ;;
  *) echo "unexpected: $*" >&2; exit 9 ;;
esac
"""


@pytest.fixture
def machine(root: Path, tmp_path: Path) -> Path:
    """A checkout on a machine that has a few tools and whatever Python the test gives it."""
    checkout = tmp_path / "poise"
    (checkout / ".ci").mkdir(parents=True)
    for name in (".ci/setup", "pyproject.toml", "constraints.txt"):
        shutil.copy(root / name, checkout / name)
    tools = tmp_path / "bin"
    tools.mkdir()
    for name in (*TOOLS, "mkdir", "cp"):
        found = shutil.which(name)
        assert found, name
        (tools / name).symlink_to(found)
    return tmp_path


def _python(machine: Path, *, version: str = "3.12.3", rclpy: bool = False, venv: bool = True) -> None:
    new = tuple(int(part) for part in version.split(".")) >= (3, 11)
    words = {True: "true", False: "false"}
    text = FAKE_PYTHON.format(version=version, rclpy=words[rclpy], ensurepip=words[venv], new=words[new])
    (machine / "bin/python3").write_text(text)
    (machine / "bin/python3").chmod(0o755)


def _setup(machine: Path, level: str = "run") -> subprocess.CompletedProcess[str]:
    environment = {"PATH": str(machine / "bin"), "HOME": os.environ.get("HOME", "/tmp")}
    return subprocess.run(
        ["bash", ".ci/setup", level],
        cwd=machine / "poise", env=environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip


def test_no_python(machine: Path) -> None:
    result = _setup(machine)
    assert result.returncode == 1
    assert "sudo apt install python3 python3-venv" in result.stderr


def test_an_old_python(machine: Path) -> None:
    _python(machine, version="3.10.12")
    assert "Python 3.11 or newer is needed" in _setup(machine).stderr


def test_no_venv_module(machine: Path) -> None:
    _python(machine, venv=False)
    result = _setup(machine)
    assert result.returncode == 1
    assert "sudo apt install python3-venv" in result.stderr


def test_wheels_where_no_ros_is_sourced(machine: Path) -> None:
    _python(machine)
    assert _setup(machine).returncode == 0
    assert "--system-site-packages" not in (machine / "poise/.venv/created").read_text()
    installed = (machine / "poise/.venv/installed").read_text()
    assert "--constraint constraints.txt" in installed and "--editable .[ros]" in installed


def test_a_sourced_ros_is_used(machine: Path) -> None:
    _python(machine, rclpy=True)
    assert _setup(machine, "dev").returncode == 0
    venv = machine / "poise/.venv"
    assert "--system-site-packages" in (venv / "created").read_text()
    installed = (venv / "installed").read_text()
    assert "--editable .[dev,bench,dataset,docs,policies,view]" in installed
    assert "--constraint constraints.txt" in installed


def test_each_level_has_what_those_before_it_have(machine: Path) -> None:
    _python(machine)
    installed = machine / "poise/.venv/installed"
    for level, extras in (("run", "ros"), ("view", "ros,view"), ("dev", "ros,dev,bench,dataset,docs,policies,view")):
        assert _setup(machine, level).returncode == 0
        assert f"--editable .[{extras}]" in installed.read_text()
    installed.unlink()
    for level in ("run", "view", "dev"):
        assert _setup(machine, level).returncode == 0
    assert not installed.exists()


def test_a_sourced_ros_with_an_old_python(machine: Path) -> None:
    _python(machine, version="3.10.12", rclpy=True)
    result = _setup(machine)
    assert result.returncode == 1
    assert "the sourced ROS 2 uses Python 3.10.12" in result.stderr


def test_the_second_time_does_nothing_and_a_change_is_noticed(machine: Path) -> None:
    _python(machine)
    assert _setup(machine, "dev").returncode == 0
    installed = machine / "poise/.venv/installed"
    installed.unlink()
    assert _setup(machine, "dev").stdout == ""
    assert _setup(machine, "run").stdout == ""  # dev includes run
    assert not installed.exists()
    with (machine / "poise/constraints.txt").open("a") as file:
        file.write("# changed\n")
    assert _setup(machine, "run").returncode == 0
    assert installed.exists()


def test_another_ros_makes_the_environment_anew(machine: Path) -> None:
    _python(machine)
    assert _setup(machine).returncode == 0
    _python(machine, rclpy=True)
    result = _setup(machine)
    assert result.returncode == 0 and "anew" in result.stdout
    assert "--system-site-packages" in (machine / "poise/.venv/created").read_text()
