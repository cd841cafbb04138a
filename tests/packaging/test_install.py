"""What an installed poise consists of: command line, ROS 2 index, executables, package data."""

import ast
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import xml.etree.ElementTree as ElementTree
import zipfile
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest

PACKAGES = ("models", "planners", "controllers", "bridge")
OF_ROS = re.compile(r"rclpy|launch|\w+_(msgs|srvs|interfaces)")
PREFIX = Path(sysconfig.get_path("data"))


@pytest.fixture(scope="module")
def project(root: Path) -> dict[str, object]:
    return tomllib.loads((root / "pyproject.toml").read_text())


@pytest.fixture(scope="module")
def wheel(root: Path, tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Wheel built from the checkout, without network."""
    pytest.importorskip("hatchling", reason="building a wheel needs hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    result = subprocess.run(build, cwd=root, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    return zipfile.ZipFile(next(folder.glob("*.whl")))


def test_the_source_distribution_is_the_whole_checkout(project: Any, root: Path) -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=root, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        pytest.skip("not a checkout")
    included = {name.strip("/") for name in project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]}
    assert {line.partition("/")[0] for line in listed.stdout.splitlines()} - {
        "pyproject.toml",
        ".gitignore",
    } <= included


def _entries(group: str) -> dict[str, str]:
    return {entry.name: entry.value for entry in distribution("poise").entry_points if entry.group == group}


@pytest.mark.parametrize("package", PACKAGES)
def test_ros_finds_the_package(package: str) -> None:
    assert (PREFIX / "share/ament_index/resource_index/packages" / package).is_file()
    manifest = ElementTree.parse(PREFIX / "share" / package / "package.xml").getroot()
    assert manifest.findtext("name") == package
    assert manifest.findtext("version") == distribution("poise").version
    assert manifest.findtext("license") == "Apache-2.0"


@pytest.mark.parametrize("package", PACKAGES)
def test_the_manifest_names_every_package_of_ros_that_is_imported(root: Path, package: str) -> None:
    imported: set[str] = set()
    for file in (root / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.split(".")[0])
    needed = {name for name in imported if OF_ROS.fullmatch(name) or name in PACKAGES} - {package}
    manifest = ElementTree.parse(root / package / "package.xml").getroot()
    assert needed <= {str(each.text) for each in manifest.iter("exec_depend")}


def test_every_node_is_an_executable_of_its_package() -> None:
    nodes = {name: value for name, value in _entries("console_scripts").items() if ".nodes." in value}
    assert set(nodes) >= {
        "robot_driver", "state_estimator", "balance_controller", "gait_planner", "motion_planner", "supervisor",
        "imu_node", "foot_sensor_node", "motor_controller", "camera_node", "vision_node",
        "range_sensor_node", "terrain_mapper",
    }  # fmt: skip
    for name, value in nodes.items():
        wrapper = PREFIX / "lib" / value.split(".")[0] / name
        assert os.access(wrapper, os.X_OK), f"{wrapper} is not executable"
        lines = wrapper.read_text().splitlines()
        assert lines == ["#!/bin/sh", f'exec "$(dirname "$0")/../../bin/{name}" "$@"']
        assert os.access(wrapper.parent / "../../bin" / name, os.X_OK)


def test_ros_finds_the_launch_file_and_what_it_runs() -> None:
    assert (PREFIX / "share/bridge/launch/humanoid.launch.py").is_file()
    poise = [PREFIX / "lib/bridge/poise", "--version"]
    result = subprocess.run(
        poise, env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True, timeout=60, check=True
    )
    assert result.stdout.startswith("poise ")


@pytest.mark.ros
def test_the_wrapper_runs_the_node_without_an_activated_environment(ros_domain_id: int) -> None:
    wrapper = PREFIX / "lib/controllers/supervisor"
    environment = {"PATH": "/usr/bin:/bin", "HOME": os.environ.get("HOME", "/tmp")}
    environment |= {name: value for name, value in os.environ.items() if name.startswith("ROS_")}
    bad = [str(wrapper), "--ros-args", "-p", "robot:=no_such_robot", "-r", "not a remap rule"]
    result = subprocess.run(bad, env=environment, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode != 0
    assert "not a remap rule" in result.stderr


def test_the_command_line_names_its_commands() -> None:
    poise = Path(sys.executable).parent / "poise"
    result = subprocess.run([poise, "--help"], capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0
    for command in ("demo", "up", "send", "mode", "robots", "bench"):
        assert re.search(rf"^\W*{command}\b", result.stdout, re.MULTILINE), f"{command} is missing:\n{result.stdout}"


def test_help_imports_nothing_heavy() -> None:
    script = "import sys, bridge.cli; print([m for m in ('numpy', 'pinocchio', 'mujoco', 'rclpy') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert result.stdout.strip() == "[]"


def test_the_wheel_carries_all_data(wheel: zipfile.ZipFile, root: Path) -> None:
    names = set(wheel.namelist())
    data = [
        file.relative_to(root).as_posix()
        for package in (*PACKAGES, "benchmarks")
        for file in (root / package).rglob("*")
        if file.suffix in {".yaml", ".xml", ".py"} and file.name != "package.xml" and "__pycache__" not in file.parts
    ]
    assert len(data) > 50
    assert not set(data) - names
    assert {f"{package}/py.typed" for package in (*PACKAGES, "benchmarks")} <= names
    assert not [name for name in names if name.startswith(("tests", "docs"))]


def test_ros_wheels_are_an_extra_for_machines_that_have_them(project: dict[str, dict[str, object]]) -> None:
    table = project["project"]
    assert not [line for line in table["dependencies"] if "ros-" in line]  # type: ignore[attr-defined]
    extra = table["optional-dependencies"]["ros"]  # type: ignore[index]
    assert extra and all(line.startswith("ros-jazzy-") for line in extra)
    assert all("platform_machine == 'x86_64'" in line and "sys_platform == 'linux'" in line for line in extra)


def test_constraints_pin_every_direct_dependency(project: dict[str, dict[str, object]], root: Path) -> None:
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    pinned = {}
    for line in (root / "constraints.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            pin = Requirement(line)
            pinned[canonicalize_name(pin.name)] = next(iter(pin.specifier)).version
    table = project["project"]
    lines = [*table["dependencies"], *(x for extra in table["optional-dependencies"].values() for x in extra)]  # type: ignore
    for line in lines:
        expected = Requirement(line)
        assert expected.specifier.contains(pinned[canonicalize_name(expected.name)]), line
