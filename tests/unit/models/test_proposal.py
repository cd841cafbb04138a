"""What is proposed for a robot that is known: the G1 and TALOS, whose profiles were written by hand."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from models.proposal.profile_text import write_proposal
from models.proposal.propose import Proposal, propose
from models.proposal.soles import largest_rectangle
from models.robot_model import RobotModel


@pytest.fixture(scope="module")
def proposal(g1: RobotModel) -> Proposal:
    return propose(g1.urdf)


@pytest.fixture(scope="module")
def proposed(proposal: Proposal, tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    return RobotModel.load(write_proposal(proposal, tmp_path_factory.mktemp("g1") / "mine.yaml")[0])


def test_the_g1_needs_no_repair(proposal: Proposal) -> None:
    assert proposal.robot is None and proposal.findings == ()


def test_base_feet_and_soles_are_those_written_by_hand(proposal: Proposal, g1: RobotModel) -> None:
    mine, hand = proposal.profile, g1.profile
    assert mine.base_link == hand.base_link and set(mine.joints) == set(hand.joints)
    for found, known in ((mine.feet.left, hand.feet.left), (mine.feet.right, hand.feet.right)):
        assert found.link == known.link
        assert found.xyz == pytest.approx(known.xyz, abs=5e-4)
        assert found.rpy == pytest.approx(known.rpy, abs=1e-6)
        assert found.rectangle == pytest.approx(known.rectangle, abs=3e-3)


def test_mirror_pairs_are_all_that_is_called_left(proposal: Proposal, g1: RobotModel) -> None:
    left = {name for name in g1.joint_names if name.startswith("left_")}
    assert dict(proposal.pairs) == {name: name.replace("left_", "right_") for name in left}


def test_height_and_posture_are_about_those_written_by_hand(proposed: RobotModel, g1: RobotModel) -> None:
    heights = [pin.centerOfMass(m.pin, m.data(), m.standing_configuration())[2] for m in (proposed, g1)]
    assert heights[0] == pytest.approx(heights[1], abs=0.005)
    legs = [i - 6 for foot in g1.feet for i in foot.joint_ids_v]
    assert proposed.posture("stand")[legs] == pytest.approx(g1.posture("stand")[legs], abs=0.02)


def test_frames_are_on_the_links_written_by_hand(proposal: Proposal, g1: RobotModel) -> None:
    for frame in ("torso", "gaze", "imu"):
        assert proposal.profile.frames[frame].link == g1.profile.frames[frame].link


def test_soles_lie_flat_with_the_com_above_their_middle(proposed: RobotModel) -> None:
    q, data = proposed.standing_configuration(), proposed.data()
    pin.framesForwardKinematics(proposed.pin, data, q)
    com = pin.centerOfMass(proposed.pin, data, q)
    middles = []
    for foot in proposed.feet:
        place = data.oMf[foot.frame_id]
        assert place.rotation == pytest.approx(np.eye(3), abs=2e-4)
        assert place.translation[2] == pytest.approx(0.0, abs=2e-4)
        middles.append(place.act(foot.corners.mean(axis=0)))
    assert com[:2] == pytest.approx(np.mean(middles, axis=0)[:2], abs=2e-3)
    assert proposed.posture("stand")[proposed.joint_index("left_knee_joint")] == pytest.approx(0.5, abs=2e-3)


def test_drives_are_of_the_size_written_by_hand(proposed: RobotModel, g1: RobotModel) -> None:
    """Within a factor of four: they are scaled from mass and height alone."""
    for mine, hand in ((proposed.armature, g1.armature), (proposed.kp, g1.kp), (proposed.kd, g1.kd)):
        assert np.all(mine > 0.25 * hand) and np.all(mine < 4.0 * hand)


def test_partners_have_the_same_drive(proposal: Proposal) -> None:
    joints = proposal.profile.joints
    assert all(joints[left] == joints[right] for left, right in proposal.pairs)


def test_the_soles_of_talos_are_found_from_a_mesh(talos: RobotModel) -> None:
    mine = propose(talos.urdf).profile
    data = talos.data()
    pin.framesForwardKinematics(talos.pin, data, pin.neutral(talos.pin))
    for found, foot in zip((mine.feet.left, mine.feet.right), talos.feet, strict=True):
        link = data.oMf[talos.pin.getFrameId(found.link)]
        assert link.act(np.array(found.xyz)) == pytest.approx(data.oMf[foot.frame_id].translation, abs=1e-3)
        # The corners of the mesh are cut: the largest rectangle within it is shorter than the flat part is long.
        assert found.rectangle == pytest.approx(foot.rectangle, abs=0.01)
        assert found.rectangle[0] >= foot.rectangle[0] - 3e-3 and found.rectangle[1] <= foot.rectangle[1] + 3e-3


def test_the_text_says_units_and_where_it_comes_from(proposal: Proposal, tmp_path: Path) -> None:
    text = write_proposal(proposal, tmp_path / "a" / "mine.yaml")[0].read_text()
    assert text.startswith("# g1_29dof_rev_1_0: proposed by `poise check-robot` from g1_29dof_rev_1_0.urdf.")
    assert "gyro_noise_density: 0.000244  # [rad/s/sqrt(Hz)]" in text


@pytest.mark.parametrize("name", ["12", "no", "knee: left #1"])
def test_a_joint_may_have_any_name(g1: RobotModel, tmp_path: Path, name: str) -> None:
    urdf = tmp_path / "odd.urdf"
    urdf.write_text(g1.urdf.read_text().replace('"left_knee_joint"', f'"{name}"'))
    found = RobotModel.load(write_proposal(propose(urdf), tmp_path / "mine.yaml")[0])
    assert found.posture("stand")[found.joint_index(name)] == pytest.approx(0.5, abs=2e-3)


def test_largest_rectangle() -> None:
    trapezoid = np.array([[-0.05, 0.025], [-0.05, -0.025], [0.12, 0.03], [0.12, -0.03]])
    assert largest_rectangle(trapezoid) == pytest.approx([-0.05, 0.12, -0.025, 0.025], abs=1e-9)
    diamond = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    assert largest_rectangle(diamond) == pytest.approx([-0.5, 0.5, -0.5, 0.5], abs=0.03)
    assert largest_rectangle(diamond[:2]) is None
