"""A URDF that cannot be used is refused with its file, the joint or link, and the cause."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

import models.urdf
from models.errors import RobotModelError
from models.robot_model import RobotModel
from models.urdf import data_folder, for_mujoco, resolve_uri


@pytest.fixture
def build(root: Path, g1: RobotModel, tmp_path: Path) -> Callable[[str], RobotModel]:
    """Load the G1 with another URDF text, referred to by a path relative to the profile."""

    def _build(text: str) -> RobotModel:
        (tmp_path / "mine.urdf").write_text(text)
        data = yaml.safe_load((root / "models" / "robots" / "g1.yaml").read_text())
        (tmp_path / "mine.yaml").write_text(yaml.safe_dump(data | {"urdf": "mine.urdf"}))
        return RobotModel.load(tmp_path / "mine.yaml")

    return _build


@pytest.fixture
def tree(g1: RobotModel) -> ET.Element:
    return ET.parse(g1.urdf).getroot()


def _find(tree: ET.Element, path: str) -> ET.Element:
    element = tree.find(path)
    assert element is not None
    return element


def test_relative_path_is_relative_to_the_profile(build: Callable[[str], RobotModel], tree: ET.Element) -> None:
    assert build(ET.tostring(tree, encoding="unicode")).nj == 29


def test_broken_xml(build: Callable[[str], RobotModel], tree: ET.Element) -> None:
    with pytest.raises(RobotModelError, match=r"mine\.urdf: not valid XML: .*line"):
        build(ET.tostring(tree, encoding="unicode")[:-20])


def test_other_xml(build: Callable[[str], RobotModel]) -> None:
    with pytest.raises(RobotModelError, match=r"mine\.urdf: the root element is <sdf>"):
        build("<sdf/>")


def test_missing_file(build: Callable[[str], RobotModel], tree: ET.Element, tmp_path: Path) -> None:
    build(ET.tostring(tree, encoding="unicode"))
    (tmp_path / "mine.urdf").unlink()
    with pytest.raises(RobotModelError, match=r"mine\.urdf: cannot be read"):
        RobotModel.load(tmp_path / "mine.yaml")


Change = Callable[[ET.Element], None]

_KNEE = "joint[@name='left_knee_joint']"
_SHIN = "link[@name='left_knee_link']"


def _remove(path: str, child: str) -> Change:
    return lambda tree: _find(tree, path).remove(_find(tree, f"{path}/{child}"))


def _set(path: str, key: str, value: str) -> Change:
    return lambda tree: _find(tree, path).set(key, value)


def _remove_link(tree: ET.Element) -> None:
    tree.remove(_find(tree, _SHIN))


def _weightless(tree: ET.Element) -> None:
    _find(tree, f"{_SHIN}/inertial/mass").set("value", "0.0")


def _pointlike(tree: ET.Element) -> None:
    inertia = _find(tree, f"{_SHIN}/inertial/inertia")
    for key in list(inertia.attrib):
        inertia.set(key, "0")


def _twice(path: str) -> Change:
    return lambda tree: tree.append(_find(tree, path))


def _second_root(tree: ET.Element) -> None:
    ET.SubElement(tree, "link", {"name": "moon"})


def _mimic(tree: ET.Element) -> None:
    ET.SubElement(_find(tree, _KNEE), "mimic", {"joint": "right_knee_joint"})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_remove(_KNEE, "limit"), "joint 'left_knee_joint': has no <limit>"),
        (_set(f"{_KNEE}/limit", "effort", "0"), "joint 'left_knee_joint': limit effort 0.0 is not positive"),
        (_set(f"{_KNEE}/limit", "velocity", "fast"), "joint 'left_knee_joint': limit velocity is 'fast'"),
        (_set(f"{_KNEE}/limit", "lower", "3.0"), "joint 'left_knee_joint': lower limit 3.0 is not below"),
        (_set(f"{_KNEE}/limit", "upper", "inf"), "joint 'left_knee_joint': limit upper is 'inf'"),
        (_set(_KNEE, "type", "floating"), "joint 'left_knee_joint': is 'floating'"),
        (_set(_KNEE, "type", "continuous"), "joint 'left_knee_joint': type 'continuous' is not supported"),
        (_set(f"{_KNEE}/child", "link", "hoof"), "joint 'left_knee_joint': child link 'hoof' does not exist"),
        (_remove(_KNEE, "parent"), "joint 'left_knee_joint': has no parent link"),
        (_mimic, "joint 'left_knee_joint': mimic joints are not supported"),
        (_remove_link, "joint 'left_knee_joint': child link 'left_knee_link' does not exist"),
        (_weightless, "the body moved by joint 'left_knee_joint' has no mass"),
        (_set(f"{_SHIN}/inertial/mass", "value", "-1"), "link 'left_knee_link': mass -1 is negative"),
        (_remove(f"{_SHIN}/inertial", "inertia"), "link 'left_knee_link': <inertial> needs <mass> and <inertia>"),
        (_set(f"{_SHIN}/inertial/inertia", "ixx", "0.9"), "joint 'left_knee_joint' has an impossible inertia"),
        (_pointlike, "joint 'left_knee_joint' has an impossible inertia: principal moments 0, 0, 0"),
        (_twice(_SHIN), "link 'left_knee_link' is defined twice"),
        (_twice(_KNEE), "joint 'left_knee_joint' is defined twice"),
        (_second_root, "expected one root link, found .*'pelvis', 'moon'"),
    ],
)
def test_bad_urdf_names_file_culprit_and_cause(
    build: Callable[[str], RobotModel], tree: ET.Element, change: Change, message: str
) -> None:
    change(tree)
    with pytest.raises(RobotModelError, match=rf"mine\.urdf: .*{message}"):
        build(ET.tostring(tree, encoding="unicode"))


def test_uris_resolve(tmp_path: Path) -> None:
    (tmp_path / "my_robot" / "urdf").mkdir(parents=True)
    folder = tmp_path / "my_robot" / "urdf"
    assert resolve_uri("package://example-robot-data/robots", folder) == data_folder() / "robots"
    assert resolve_uri("package://my_robot/meshes/a.stl", folder) == tmp_path / "my_robot" / "meshes" / "a.stl"
    assert resolve_uri("file:///a/b.stl", folder) == Path("/a/b.stl")
    assert resolve_uri("/a/b.stl", folder) == Path("/a/b.stl")
    assert resolve_uri("package:///my_robot/a.stl", folder) == tmp_path / "my_robot" / "a.stl"
    (tmp_path / "elsewhere" / "my_robot").mkdir(parents=True)
    assert resolve_uri("package://my_robot/a.stl", folder, [tmp_path / "elsewhere"]).parent.parent.name == "elsewhere"
    assert resolve_uri("meshes/b.stl", folder) == folder / "meshes" / "b.stl"


def test_missing_data_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models.urdf, "DATA_PACKAGE", "no-such-package")
    monkeypatch.setattr(models.urdf, "_DATA_SHARE", Path("share") / "no-such-package")
    with pytest.raises(RobotModelError, match="add the package 'no-such-package'"):
        data_folder()


def test_only_readable_meshes_are_kept_for_pictures(tree: ET.Element, g1: RobotModel, tmp_path: Path) -> None:
    """A DAE visual gives way to the STL collision shape; where there is none, the link has no picture."""
    for link, collision in (("left_knee_link", True), ("pelvis", False)):
        mesh = _find(tree, f"link[@name='{link}']/visual/geometry/mesh")
        mesh.set("filename", mesh.get("filename", "").replace(".STL", ".dae"))
        assert (tree.find(f"link[@name='{link}']/collision") is not None) == collision
    (tmp_path / "mine.urdf").write_text(ET.tostring(tree, encoding="unicode"))
    result = for_mujoco(tmp_path / "mine.urdf", visuals=True)
    kept = _find(result, f"{_SHIN}/visual/geometry/mesh").get("filename", "")
    assert kept.endswith("left_knee_link.STL") and Path(kept).is_file()
    assert result.find("link[@name='pelvis']/visual") is None
    assert not list(for_mujoco(g1.urdf, visuals=False).iter("mesh"))
