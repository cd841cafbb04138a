"""The cache of compiled kernels follows the sources that a kernel is made from, and nothing else."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from models.numerics import compiled
from models.numerics.compiled import KernelCacheLocator, source_hash
from planners.gait import swing

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(
    ("changed", "matters"),
    [("kernel.py", True), ("callee.py", True), ("constants.py", True), ("records.py", True), ("other.py", False)],
)
def test_the_cache_follows_a_kernel_and_what_it_calls(tmp_path: Path, changed: str, matters: bool) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / "constants.py").write_text("GAIN = 2.0\n")
    (folder / "callee.py").write_text("from models.numerics.compiled import njit\nfrom models.constants import GAIN\n")
    (folder / "records.py").write_text("class Gains(NamedTuple):\n    kp: float\n")
    (folder / "kernel.py").write_text(
        "from models.numerics.compiled import njit\n"
        "from models.callee import double\nfrom models.records import Gains\n"
    )
    (folder / "other.py").write_text("from models.numerics.compiled import njit\n")
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy / "models")
    (copy / "models" / changed).write_text((folder / changed).read_text() + "# changed\n")
    same = source_hash(folder / "kernel.py", tmp_path) == source_hash(copy / "models" / "kernel.py", copy)
    assert same is not matters


def test_kernels_are_kept_by_content() -> None:
    function = swing._advance
    path = KernelCacheLocator.from_function(function.py_func, swing.__file__)
    assert path is not None
    assert function.stats.cache_path == path.get_cache_path()
    assert source_hash(Path(swing.__file__)) in path.get_cache_path()


def angle_of(record: Any) -> Any:
    return record[0]


def test_types_that_no_longer_exist_are_a_miss(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    class Record(NamedTuple):
        angle: float

    monkeypatch.setattr(compiled, "_cache_folder", lambda: tmp_path)
    monkeypatch.setattr(sys.modules[__name__], "Record", Record, raising=False)
    Record.__qualname__ = "Record"

    def make() -> Any:
        return compiled.njit(cache=True)(angle_of)

    monkeypatch.setattr(
        KernelCacheLocator, "from_function", classmethod(lambda cls, function, file: cls(function, file))
    )
    assert make()(Record(0.5)) == 0.5
    monkeypatch.delattr(sys.modules[__name__], "Record")
    kernel = make()
    assert kernel((0.5,)) == 0.5
    assert not kernel.stats.cache_hits


def test_processes_that_compile_at_the_same_time_never_take_each_others_code(tmp_path: Path) -> None:
    class Racing(compiled._Index):
        def _load_index(self) -> dict[Any, Any]:
            return {}  # read before the other one wrote it

    first, second, reader = (kind(str(tmp_path), "kernel", "stamp") for kind in (Racing, Racing, compiled._Index))
    save = first._save_data

    def save_late(name: str, data: Any) -> None:
        second.save("integers", "code for integers")
        save(name, data)

    first._save_data = save_late  # type: ignore[method-assign]
    first.save("floats", "code for floats")
    assert reader.load("integers") == "code for integers"
    assert reader.load("floats") is None  # compiled again


def test_without_a_writable_cache_the_folder_ends_with_the_process(tmp_path: Path) -> None:
    program = (
        "import os, pathlib, sys; from models.numerics.compiled import _cache_folder; folder = _cache_folder()\n"
        "if not (child := os.fork()): sys.exit()\n"
        "os.waitpid(child, 0); print(folder.parent, folder.is_dir())"
    )
    places = {"NUMBA_CACHE_DIR": str(Path(os.devnull) / "numba"), "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | places, cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(tmp_path), "True"] and not list(tmp_path.iterdir())


def test_functions_of_other_projects_are_left_to_numba() -> None:
    assert KernelCacheLocator.from_function(shutil.which, shutil.__file__) is None


def test_every_kernel_compiles_through_it() -> None:
    for package in ("models", "planners", "controllers", "bridge"):
        for file in (ROOT / package).rglob("*.py"):
            assert "from numba import" not in file.read_text() or file.name == "compiled.py", file
