"""URDFs that say too little are repaired and every change is reported; those of no use are refused by name."""

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from models.errors import ConfigError, RobotModelError
from models.leg_shapes import leg_shapes
from models.proposal.profile_text import write_proposal
from models.proposal.propose import FORWARD, Proposal, propose
from models.robot_model import RobotModel
from models.urdf import data_folder

ROBOTS = data_folder() / "robots"

Change = Callable[[ET.Element], None]


@pytest.fixture
def changed(g1: RobotModel, tmp_path: Path) -> Callable[[Change], Proposal]:
    """The proposal for a changed G1, which the loader takes."""

    def _changed(change: Change) -> Proposal:
        tree = ET.parse(g1.urdf).getroot()
        change(tree)
        (tmp_path / "mine.urdf").write_text(ET.tostring(tree, encoding="unicode"))
        proposal = propose(tmp_path / "mine.urdf")
        RobotModel.load(write_proposal(proposal, tmp_path / "out" / "mine.yaml")[0])
        return proposal

    return _changed


def find(tree: ET.Element, path: str) -> ET.Element:
    element = tree.find(path)
    assert element is not None, path
    return element


def findings(proposal: Proposal, culprit: str) -> list[str]:
    return [f"{f.severity}: {f.fault}: {f.remedy}" for f in proposal.findings if f"'{culprit}'" in f.culprit]


def test_a_mimic_joint_is_fixed(changed: Callable[[Change], Proposal]) -> None:
    def mimic(tree: ET.Element) -> None:
        ET.SubElement(find(tree, "joint[@name='left_wrist_yaw_joint']"), "mimic", joint="left_wrist_pitch_joint")

    proposal = changed(mimic)
    assert "left_wrist_yaw_joint" not in proposal.profile.joints
    assert findings(proposal, "left_wrist_yaw_joint") == ["note: follow another joint (mimic): fixed at zero"]
    assert findings(proposal, "right_wrist_yaw_joint") == ["note: no mirror image on the other side: kept as it is"]


def test_repaired_copies_of_files_of_one_name_are_kept_apart(g1: RobotModel, tmp_path: Path) -> None:
    loaded = {}
    for fixed in ("left_wrist_yaw_joint", "right_wrist_yaw_joint"):
        tree = ET.parse(g1.urdf).getroot()
        ET.SubElement(find(tree, f"joint[@name='{fixed}']"), "mimic", joint="waist_yaw_joint")
        source = tmp_path / fixed / "robot.urdf"
        source.parent.mkdir()
        source.write_text(ET.tostring(tree, encoding="unicode"))
        proposal = propose(source)
        loaded[fixed] = write_proposal(proposal, tmp_path / f"{fixed}.yaml")[0]
    assert all(fixed not in RobotModel.load(profile).joint_names for fixed, profile in loaded.items())
    proposal = replace(proposal, source=tmp_path / "mine_repaired.urdf")
    with pytest.raises(ConfigError, match="would overwrite it"):
        write_proposal(proposal, tmp_path / "mine.yaml")


def test_missing_limits_are_named_and_guessed(changed: Callable[[Change], Proposal]) -> None:
    def strip(tree: ET.Element) -> None:
        find(tree, "joint[@name='left_knee_joint']/limit").set("effort", "0")
        find(tree, "joint[@name='waist_yaw_joint']").set("type", "continuous")
        del find(tree, "joint[@name='right_elbow_joint']/limit").attrib["velocity"]

    proposal = changed(strip)
    (torque, differing) = findings(proposal, "left_knee_joint")
    assert torque.startswith("wrong: no torque limit (effort missing or zero): ")
    assert differing.startswith("wrong: torque limits differ: ")
    assert findings(proposal, "waist_yaw_joint") == ["wrong: no position limits: 3.1416 rad to both sides assumed"]
    assert findings(proposal, "right_elbow_joint")[0].startswith("wrong: no velocity limit: 10 rad/s assumed")


def test_a_powerless_finger_is_fixed(changed: Callable[[Change], Proposal]) -> None:
    def finger(tree: ET.Element) -> None:
        link = ET.SubElement(tree, "link", name="thumb")
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value="0.02")
        ET.SubElement(inertial, "inertia", ixx="1e-5", iyy="1e-5", izz="1e-5", ixy="0", ixz="0", iyz="0")
        joint = ET.SubElement(tree, "joint", name="thumb_joint", type="revolute")
        ET.SubElement(joint, "parent", link="left_rubber_hand")
        ET.SubElement(joint, "child", link="thumb")
        ET.SubElement(joint, "limit", lower="0", upper="1", effort="0", velocity="0")

    proposal = changed(finger)
    assert "thumb_joint" not in proposal.profile.joints
    assert findings(proposal, "thumb_joint") == ["note: no torque limit, and almost no mass to move: fixed at zero"]


def test_links_called_like_frames_are_renamed(changed: Callable[[Change], Proposal]) -> None:
    def rename(tree: ET.Element) -> None:
        find(tree, "link[@name='left_rubber_hand']").set("name", "l_wrist")
        for joint in tree.findall("joint"):
            for end in ("parent", "child"):
                if find(joint, end).get("link") == "left_rubber_hand":
                    find(joint, end).set("link", "l_wrist")

    proposal = changed(rename)
    assert findings(proposal, "l_wrist") == ["note: named like a frame of the profile: renamed: _link is appended"]
    assert proposal.robot is not None and proposal.robot.find("link[@name='l_wrist_link']") is not None


def test_a_base_that_looks_backward_is_turned_round(changed: Callable[[Change], Proposal], g1: RobotModel) -> None:
    def turn(tree: ET.Element) -> None:
        """Give every child of the pelvis, and the pelvis itself, the half turn that swaps its x and y."""
        for joint in tree.findall("joint"):
            if find(joint, "parent").get("link") == "pelvis":
                _turn(joint)
        pelvis = find(tree, "link[@name='pelvis']")
        for part in (find(pelvis, "inertial"), *pelvis.findall("visual"), *pelvis.findall("collision")):
            _turn(part)

    proposal = changed(turn)
    assert proposal.profile.base_link == FORWARD
    assert findings(proposal, "pelvis")[0].startswith("note: the base's x axis points backward")
    assert proposal.profile.feet.left.link == "left_ankle_roll_link"
    assert proposal.com_height == pytest.approx(0.68, abs=0.005)
    assert proposal.profile.feet.left.rectangle == pytest.approx(g1.profile.feet.left.rectangle, abs=3e-3)


def _turn(part: ET.Element) -> None:
    origin = part.find("origin")
    if origin is None:
        origin = ET.SubElement(part, "origin")
    half = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, np.pi), np.zeros(3))
    xyz, rpy = (np.array([float(x) for x in origin.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    turned = half * pin.SE3(pin.rpy.rpyToMatrix(*rpy), xyz)
    origin.set("xyz", " ".join(f"{value:.12g}" for value in turned.translation))
    origin.set("rpy", " ".join(f"{value:.12g}" for value in pin.rpy.matrixToRpy(turned.rotation)))


def test_an_impossible_inertia_is_taken_from_the_other_side(changed: Callable[[Change], Proposal]) -> None:
    def corrupt(tree: ET.Element) -> None:
        find(tree, "link[@name='right_knee_link']/inertial/inertia").set("ixx", "0.9")

    proposal = changed(corrupt)
    (text,) = findings(proposal, "right_knee_link")
    assert text.startswith("wrong: impossible inertia") and "mirror image of that of link 'left_knee_link'" in text
    assert proposal.robot is not None
    left, right = (
        {k: float(v) for k, v in find(proposal.robot, f"link[@name='{side}_knee_link']/inertial/inertia").items()}
        for side in ("left", "right")
    )
    signs = {"ixx": 1, "iyy": 1, "izz": 1, "ixz": 1, "ixy": -1, "iyz": -1}
    assert right == pytest.approx({key: signs[key] * value for key, value in left.items()}, rel=1e-3, abs=1e-7)


def test_an_unreadable_visual_becomes_a_box(changed: Callable[[Change], Proposal], tmp_path: Path) -> None:
    """iCub's foot is a Collada mesh with y up: 15 cm long, 6 cm wide, and as high as it stands in the file."""
    foot = ROBOTS / "icub_description/meshes/upmc/visual/icub_l_foot.dae"

    def swap(tree: ET.Element) -> None:
        shutil.copy(foot, tmp_path)
        find(tree, "link[@name='left_rubber_hand']/visual/geometry/mesh").set("filename", foot.name)

    proposal = changed(swap)
    texts = findings(proposal, "left_rubber_hand")
    assert "note: .dae meshes that MuJoCo cannot read: drawn as boxes of their bounds" in texts
    assert "note: Collada meshes with y up, which Pinocchio does not rotate: rotated to z up" in texts
    assert proposal.robot is not None
    box = find(proposal.robot, "link[@name='left_rubber_hand']/visual/geometry/box")
    size = [float(value) for value in (box.get("size") or "").split()]
    assert size == pytest.approx([0.068, 0.060, 0.1555], abs=2e-3)


def test_a_robot_without_its_meshes_has_the_soles_of_its_collision_shapes(
    changed: Callable[[Change], Proposal], g1: RobotModel, tmp_path: Path
) -> None:
    """The G1's feet are spheres at the corners of the soles; every mesh is elsewhere."""

    def lose(tree: ET.Element) -> None:
        for mesh in tree.iter("mesh"):
            mesh.set("filename", "package://elsewhere/" + (mesh.get("filename") or "").split("/")[-1])

    proposal = changed(lose)
    (text,) = findings(proposal, "left_knee_link")
    assert text.startswith("wrong: mesh files are missing") and "--package-dir" in text
    assert proposal.profile.feet.left.rectangle == pytest.approx(g1.profile.feet.left.rectangle, abs=3e-3)
    model = RobotModel.load(tmp_path / "out" / "mine.yaml")
    assert model.mass == pytest.approx(g1.mass)
    assert len(leg_shapes(model).collisionPairs) < len(leg_shapes(g1).collisionPairs)


def test_the_laws_go_without_the_shapes_of_missing_meshes(g1: RobotModel, tmp_path: Path) -> None:
    """A profile by hand, whose URDF lies where its meshes are not."""
    tree = ET.parse(g1.urdf).getroot()
    for mesh in tree.iter("mesh"):
        mesh.set("filename", "elsewhere.stl")
    (tmp_path / "mine.urdf").write_text(ET.tostring(tree, encoding="unicode"))
    (tmp_path / "mine.yaml").write_text("extends: g1\nurdf: mine.urdf\n")
    model = RobotModel.load(tmp_path / "mine.yaml")
    with pytest.warns(UserWarning, match="mine.urdf: meshes of .*left_knee_link.* are missing"):
        shapes = leg_shapes(model)
    feet = {model.pin.frames[body.parentFrame].name for body in shapes.geometryObjects}
    assert feet == {"left_ankle_roll_link", "right_ankle_roll_link"}  # spheres


def _weightless(tree: ET.Element) -> None:
    find(tree, "link[@name='left_knee_link']/inertial/mass").set("value", "0.0")


def _pointed(tree: ET.Element) -> None:
    foot = find(tree, "link[@name='left_ankle_roll_link']")
    for collision in foot.findall("collision")[1:]:
        foot.remove(collision)


def _one_leg(tree: ET.Element) -> None:
    find(tree, "joint[@name='left_hip_pitch_joint']").set("type", "fixed")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_weightless, "the body moved by joint 'left_knee_joint' has no mass"),
        (_pointed, "no feet: link 'left_ankle_roll_link' has no flat sole: 0 x [0-9] mm"),
        (_one_leg, "no feet: .* without a mirror image: .*'right_hip_pitch_joint'"),
    ],
)
def test_a_urdf_of_no_use_is_refused_by_name(
    changed: Callable[[Change], Proposal], change: Change, message: str
) -> None:
    with pytest.raises(RobotModelError, match=rf"mine\.urdf: {message}"):
        changed(change)


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        ("alex_description/urdf/alex_nub_hands.urdf", "no feet: no two mirrored chains .* the base 'Pelvis'"),
        ("bolt_description/robots/bolt.urdf", "no feet: the leg that ends at joint 'FL_KFE' has 3 joints"),
        ("human_description/robots/human.urdf", "the body moved by joint 'left_hip_Z' has no mass"),
    ],
)
def test_robots_without_feet_are_refused(urdf: str, message: str) -> None:
    with pytest.raises(RobotModelError, match=message):
        propose(ROBOTS / urdf)


def test_packages_are_looked_for_in_the_given_folders(g1: RobotModel, tmp_path: Path) -> None:
    tree = ET.parse(g1.urdf).getroot()
    for mesh in tree.iter("mesh"):
        mesh.set("filename", mesh.get("filename", "").replace("example-robot-data/robots/g1_description", "g1_here"))
    (tmp_path / "g1.urdf").write_text(ET.tostring(tree, encoding="unicode"))
    (tmp_path / "packages").mkdir()
    (tmp_path / "packages" / "g1_here").symlink_to(ROBOTS / "g1_description")
    assert any(finding.fault.startswith("mesh files are missing") for finding in propose(tmp_path / "g1.urdf").findings)
    proposal = propose(tmp_path / "g1.urdf", [tmp_path / "packages"])
    assert proposal.findings == () and proposal.robot is not None  # written anew, with the files' paths


def test_wrong_limits_of_a_robot_are_reported() -> None:
    """The URDF of simple_humanoid has the left leg's limits one joint off, no feet, and inertias of 1 kg.m^2."""
    proposal = propose(ROBOTS / "simple_humanoid_description/urdf/simple_humanoid.urdf")
    knee = findings(proposal, "LLEG_KNEE")
    assert knee[0].startswith(
        "wrong: ranges differ: [-2.10, 0.70] and, mirrored, [0.00, 2.62] rad; torque limits differ"
    )
    assert any("no shape below joint 'LLEG_ANKLE_R'" in text for text in findings(proposal, "l_ankle"))
    assert any("a placeholder" in text for text in findings(proposal, "LLEG_LINK1"))
    assert proposal.unmet in proposal.findings and proposal.unmet is not None
    assert proposal.unmet.culprit == "joint 'RLEG_ANKLE_P' at the limit"
    assert "need joint 'RLEG_ANKLE_P' at -0.09 of [0.00, 2.62] rad" in proposal.unmet.fault


def test_grippers_without_mass_are_fixed_and_a_round_foot_stands_level() -> None:
    """Romeo of LAAS: its meshes are missing, so that a cylinder is what remains of a foot."""
    proposal = propose(ROBOTS / "romeo_description/urdf/romeo_laas_small.urdf")
    assert any("no link below it has mass" in text for text in findings(proposal, "l_gripper_joint"))
    assert "l_gripper_joint" not in proposal.profile.joints and proposal.unmet is None
