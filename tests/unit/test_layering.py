"""Imports point left only: models <- planners <- controllers <- bridge <- benchmarks."""

import ast
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

MAY_IMPORT = {
    "models": {"models"},
    "planners": {"models", "planners"},
    "controllers": {"models", "planners", "controllers"},
    "bridge": {"models", "planners", "controllers", "bridge"},
    "benchmarks": {"models", "planners", "controllers", "bridge", "benchmarks"},
}
MUJOCO_FILES = ("models/mujoco_model.py", "models/mujoco_spec.py")
ROS_SUFFIXES = ("_msgs", "_srvs", "_interfaces")


def _imports(source: str, package: str) -> set[str]:
    """Absolute names of the modules that a source text imports, at any depth of its code."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names.add(f"{package}.{node.module or ''}" if node.level else node.module or "")
        elif (
            isinstance(node, ast.Call)
            and getattr(node.func, "attr", getattr(node.func, "id", "")) in {"import_module", "__import__"}
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            names.add(str(node.args[0].value))
    return names


def _is_ros(name: str) -> bool:
    top = name.split(".")[0]
    return top in {"rclpy", "rosidl_runtime_py", "tf2_ros"} or top.endswith(ROS_SUFFIXES)


def violations(path: str, source: str) -> list[str]:
    """What a file imports although its place in the tree forbids it.

    Args:
        path: Path relative to the root of the repository.
        source: Text of the file.

    Returns:
        One line per forbidden import.
    """
    parts = Path(path).parts
    package = parts[0]
    may_use_ros = package == "bridge" or "nodes" in parts or parts[:2] == ("benchmarks", "graph")
    may_use_mujoco = package == "bridge" or path in MUJOCO_FILES
    found = []
    for name in sorted(_imports(source, package)):
        top = name.split(".")[0]
        if top in MAY_IMPORT and top not in MAY_IMPORT[package]:
            found.append(f"{path}: {package} must not import {name}")
        if _is_ros(name) and not may_use_ros:
            found.append(f"{path}: {name} belongs in */nodes/ and bridge/")
        if top == "mujoco" and not may_use_mujoco:
            found.append(f"{path}: mujoco belongs in bridge/ and models/mujoco_*.py")
        if ".nodes" in name and "nodes" not in parts and package not in {"bridge", "benchmarks"}:
            found.append(f"{path}: a law must not import the nodes {name}")
    return found


def test_imports_point_left(root: Path) -> None:
    files = [file for package in MAY_IMPORT for file in (root / package).rglob("*.py")]
    assert len(files) > 10
    found = [
        line
        for file in files
        for line in violations(file.relative_to(root).as_posix(), file.read_text(encoding="utf-8"))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("models/a.py", "import controllers.balance.controller"),
        ("planners/a.py", "from controllers import balance"),
        ("planners/a.py", "from controllers.stack import ControlStack"),
        ("bridge/a.py", "def f():\n    import benchmarks.stability.push"),
        ("bridge/a.py", "import importlib\nimportlib.import_module('benchmarks.stability.push')"),
        ("controllers/a.py", "import rclpy"),
        ("models/a.py", "from sensor_msgs.msg import JointState"),
        ("planners/a.py", "import std_srvs.srv"),
        ("controllers/a.py", "import mujoco"),
        ("models/b.py", "import mujoco.viewer"),
        ("controllers/a.py", "from controllers.nodes.supervisor import main"),
        ("benchmarks/a.py", "import rclpy"),
        ("benchmarks/a.py", "import mujoco"),
    ],
)
def test_a_forbidden_import_is_found(path: str, source: str) -> None:
    assert violations(path, source)


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("models/mujoco_model.py", "import mujoco"),
        ("controllers/nodes/supervisor.py", "import rclpy\nfrom models.nodes.lifecycle import LifecycleNode"),
        ("bridge/a.py", "import mujoco, rclpy, controllers.balance.controller, planners.motion"),
        ("benchmarks/a.py", "from bridge.closed_loop import ClosedLoop"),
        ("benchmarks/graph/ping_pong.py", "import rclpy"),
    ],
)
def test_a_permitted_import_passes(path: str, source: str) -> None:
    assert not violations(path, source)


def test_the_laws_import_without_ros_and_mujoco(root: Path) -> None:
    """Every module of the laws loads in an interpreter where rclpy, messages and mujoco cannot be imported."""
    modules = [
        ".".join(file.relative_to(root).with_suffix("").parts)
        for package in ("models", "planners", "controllers")
        for file in sorted((root / package).rglob("*.py"))
        if "nodes" not in file.parts and file.relative_to(root).as_posix() not in MUJOCO_FILES
    ]
    script = textwrap.dedent(
        f"""
        import importlib, sys

        class Blocked:
            def find_spec(self, name, path=None, target=None):
                top = name.split(".")[0]
                if top in ("rclpy", "mujoco") or top.endswith({ROS_SUFFIXES!r}):
                    raise ImportError(f"{{name}} is blocked")

        sys.meta_path.insert(0, Blocked())
        try:
            import rclpy
        except ImportError:
            pass
        else:
            raise SystemExit("the block does not work")
        for name in {modules!r}:
            importlib.import_module(name)
        print("loaded", len({modules!r}))
        """
    )
    result = subprocess.run(
        [sys.executable, "-c", script], cwd=root, capture_output=True, text=True, timeout=120, check=False
    )
    assert result.returncode == 0, result.stderr[-3000:]
    assert result.stdout.split() == ["loaded", str(len(modules))]
