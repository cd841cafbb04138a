"""Building interfaces: what is missing is named and nothing else suffers; what is built is not built again."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rosidl_generator_py")
from models.errors import MessageError, PoiseError
from models.nodes import interface_build
from models.nodes.interface_build import DEFINITIONS, PACKAGES, build_interfaces, install, require_tools
from models.nodes.interfaces import interface


def compiler() -> bool:
    try:
        require_tools()
    except PoiseError:
        return False
    return True


def test_every_package_of_definitions_is_built() -> None:
    assert {path.name for path in DEFINITIONS.iterdir()} == set(PACKAGES)


def test_cmake_builds_the_same_definitions() -> None:
    folder = DEFINITIONS / "poise_interfaces"
    text = (folder / "CMakeLists.txt").read_text()
    for path in folder.rglob("*"):
        if path.suffix in (".msg", ".srv", ".action"):
            assert f'"{path.relative_to(folder).as_posix()}"' in text


def test_a_missing_compiler_is_named_and_all_else_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(interface_build, "PACKAGES", {"absent_interfaces": ()})
    said: list[str] = []
    assert build_interfaces(tmp_path, said.append) is False
    assert "absent_interfaces is left out" in said[0] and "gcc, g++ not found" in said[0]
    assert "sudo apt install g++ python3-dev" in said[0]


def test_what_is_not_built_is_named_with_how_it_is() -> None:
    with pytest.raises(MessageError, match="no poise_interfaces/srv/Fly: build them with: python -m"):
        interface("poise_interfaces", "srv", "Fly")


@pytest.mark.parametrize("deletions", [1, 2, 3])
def test_a_build_that_ends_while_it_deletes_leaves_a_whole_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deletions: int
) -> None:
    place, made, delete, done = tmp_path / "package", tmp_path / "made", shutil.rmtree, []
    for folder, text in ((place, "old"), (made, "new")):
        folder.mkdir()
        (folder / "file").write_text(text)

    def delete_and_end(path: Path, **options: bool) -> None:
        delete(path, **options)
        done.append(path)
        if len(done) == deletions:
            raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "rmtree", delete_and_end)
    with pytest.raises(KeyboardInterrupt):
        install(made, place)
    assert (place / "file").read_text() == ("new" if deletions == 3 else "old")


@pytest.mark.slow
@pytest.mark.skipif(not compiler(), reason="no compiler; Debian and Ubuntu: sudo apt install g++ python3-dev")
def test_a_package_is_built_once_and_again_when_its_definitions_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(DEFINITIONS / "poise_interfaces", tmp_path / "definitions/new_interfaces")
    (tmp_path / "prefix").mkdir()
    monkeypatch.setattr(interface_build, "DEFINITIONS", tmp_path / "definitions")
    monkeypatch.setattr(interface_build, "PACKAGES", {"new_interfaces": ("geometry_msgs", "trajectory_msgs")})
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "prefix"))
    for path in (tmp_path / "definitions/new_interfaces").rglob("*.*"):
        path.write_text(path.read_text().replace("poise_interfaces", "new_interfaces"))
    said: list[str] = []
    assert build_interfaces(tmp_path, said.append) and said == ["new_interfaces: built"]
    assert build_interfaces(tmp_path, said.append) and len(said) == 1
    code = (
        "from new_interfaces.srv import SetMode; SetMode.__class__.__import_type_support__(); print(SetMode.Request())"
    )
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.stdout.strip() == "new_interfaces.srv.SetMode_Request(mode='')", result.stderr
    index = tmp_path / "prefix/share/ament_index/resource_index/rosidl_interfaces/new_interfaces"
    assert "srv/SetMode.srv" in index.read_text().split()
    (tmp_path / "definitions/new_interfaces/srv/SetMode.srv").write_text("bool fly\n---\nint7 broken\n")
    assert build_interfaces(tmp_path, said.append) is False
    assert "new_interfaces is left out" in said[-1] and "the generators failed" in said[-1]
