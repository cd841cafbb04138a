"""Imports point left only, models <- planners <- controllers <- bridge <- benchmarks; no circles, no large folders."""

import ast
import subprocess
import sys
import textwrap
from collections import Counter
from contextlib import nullcontext
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

MAY_IMPORT = {
    "models": {"models"},
    "planners": {"models", "planners"},
    "controllers": {"models", "planners", "controllers"},
    "bridge": {"models", "planners", "controllers", "bridge"},
    "benchmarks": {"models", "planners", "controllers", "bridge", "benchmarks"},
}
MUJOCO_FILES = ("models/mujoco_model.py", "models/mujoco_spec.py", "models/proposal/mjcf.py")
FILES_MAX = 25  #: Python files of a folder
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


def _module(path: Path) -> str:
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


def import_graph(sources: dict[Path, str]) -> dict[Path, set[Path]]:
    """The files that each file imports, at any depth of its code and for types alone too; paths as in ``sources``."""
    paths = {_module(path): path for path in sources}
    graph: dict[Path, set[Path]] = {}
    for path, source in sources.items():
        names: set[str] = set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                names.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                deep = {f"{node.module}.{alias.name}" for alias in node.names}
                names |= {name if name in paths else node.module for name in deep}
        graph[path] = {paths[name] for name in names if name in paths} - {path}
    return graph


def folder_graph(graph: dict[Path, set[Path]]) -> dict[Path, set[Path]]:
    """The folders that each folder imports from."""
    folders: dict[Path, set[Path]] = {}
    for path, imported in graph.items():
        folders.setdefault(path.parent, set()).update({each.parent for each in imported} - {path.parent})
    return folders


def test_imports_have_no_circle(root: Path) -> None:
    files = [file for package in MAY_IMPORT for file in (root / package).rglob("*.py")]
    graph = import_graph({file.relative_to(root): file.read_text(encoding="utf-8") for file in files})
    assert sum(map(len, graph.values())) > 500
    TopologicalSorter(graph).prepare()
    TopologicalSorter(folder_graph(graph)).prepare()


@pytest.mark.parametrize(
    ("source", "files", "folders"),
    [
        ("from models.b.two import g", True, True),
        ("def f():\n    import models.b.two", True, True),
        ("from models.b import three", False, True),
        ("from models.a import four", False, False),
    ],
)
def test_a_circle_is_found(source: str, files: bool, folders: bool) -> None:
    texts = {"a/one": source, "a/four": "", "b/two": "from models.a import one", "b/three": "", "a/__init__": ""}
    graph = import_graph({Path(f"models/{name}.py"): text for name, text in texts.items()})
    for edges, circle in ((graph, files), (folder_graph(graph), folders)):
        with pytest.raises(CycleError) if circle else nullcontext():
            TopologicalSorter(edges).prepare()


def test_folders_are_small(root: Path) -> None:
    files = [file for folder in (*MAY_IMPORT, "tests") for file in (root / folder).rglob("*.py")]
    large = {folder: n for folder, n in Counter(file.parent for file in files).items() if n > FILES_MAX}
    assert not large


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


def without(root: Path, blocked: tuple[str, ...], code: str) -> list[str]:
    """Words that code prints in an interpreter where these modules and the messages cannot be imported."""
    script = f"""
        import importlib, sys

        class Blocked:
            def find_spec(self, name, path=None, target=None):
                top = name.split(".")[0]
                if top in {blocked!r} or top.endswith({ROS_SUFFIXES!r}):
                    raise ModuleNotFoundError(f"{{name}} is blocked")

        sys.meta_path.insert(0, Blocked())
        try:
            import rclpy
        except ImportError:
            pass
        else:
            raise SystemExit("the block does not work")
        """
    words = [sys.executable, "-c", textwrap.dedent(script) + textwrap.dedent(code)]
    result = subprocess.run(words, cwd=root, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr[-3000:]
    return result.stdout.split()


def test_the_laws_import_without_ros_and_mujoco(root: Path) -> None:
    modules = [
        ".".join(file.relative_to(root).with_suffix("").parts)
        for package in ("models", "planners", "controllers")
        for file in sorted((root / package).rglob("*.py"))
        if "nodes" not in file.parts and file.relative_to(root).as_posix() not in MUJOCO_FILES
    ]
    code = f"""
        for name in {modules!r}:
            importlib.import_module(name)
        print("loaded", len({modules!r}))
        """
    assert without(root, ("rclpy", "mujoco"), code) == ["loaded", str(len(modules))]


@pytest.mark.long
def test_benchmarks_load_without_ros_or_name_it(root: Path) -> None:
    code = """
        from benchmarks.core.benchmark import catalogue
        from models.errors import PoiseError
        for name, listed in catalogue().items():
            try:
                listed.load()
            except PoiseError as error:
                assert "poise[ros]" in str(error) and "is blocked" in str(error), error
                print(name)
        """
    refused = {"latency", "graph_faults", "hardware_faults", "sim2sim", "sim2sim_sdk"}
    assert set(without(root, ("rclpy", "rosidl_runtime_py", "tf2_ros"), code)) == refused
