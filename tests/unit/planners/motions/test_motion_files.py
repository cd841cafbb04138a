"""Motions from files: what they may say, and that a bad one is named with its key."""

from pathlib import Path

import numpy as np
import pytest

from models.errors import ConfigError, UnreachableError
from planners.library import load_motion
from planners.motion import MotionPlanner
from tests.motions import load

NOD = """
name: nod
description: Look down and up again.
key_poses:
  - name: down
    duration: 0.5
    joints: {{g1: {{waist_pitch_joint: {pitch}}}, talos: {{head_1_joint: {pitch}}}}}
    {more}
  - {{name: up, duration: 0.5}}
"""


def motion_file(folder: Path, pitch: float = 0.2, more: str = "") -> Path:
    path = folder / "nod.yaml"
    path.write_text(NOD.format(pitch=pitch, more=more), encoding="utf-8")
    return path


def test_own_motion_is_planned(tmp_path: Path) -> None:
    for name in ("g1", "talos"):
        model = load(name)[0]
        planner = MotionPlanner(model, extra=[motion_file(tmp_path)])
        assert "nod" in planner.names
        plan = planner.plan("nod", model.posture("stand"))
        joint = model.joint_index({"g1": "waist_pitch_joint", "talos": "head_1_joint"}[name])
        assert plan.positions[:, joint].max() == pytest.approx(0.2, abs=0.01)
        assert plan.positions[-1, joint] == pytest.approx(model.posture("stand")[joint], abs=1e-6)


def test_preferred_joints_yield_to_targets(tmp_path: Path) -> None:
    model = load("g1")[0]
    path = motion_file(tmp_path, more="prefer: {g1: {left_elbow_joint: 0.4}}")
    plan = MotionPlanner(model, extra=[path]).plan("nod", model.posture("stand"))
    elbow = plan.positions[:, model.joint_index("left_elbow_joint")]
    assert elbow.min() == pytest.approx(0.4, abs=0.02)


def test_packaged_name_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: wave\ndescription: x\nkey_poses: [{name: a, duration: 1.0}]\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"mine\.yaml: name: a motion 'wave' exists already"):
        MotionPlanner(load("g1")[0], extra=[path])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("speed: 2.0", r"key_poses\.0\.speed"),
        ("hold: -1.0", r"key_poses\.0\.hold"),
        ("hold: .nan", r"nod\.yaml"),
        ("posture: sitting", r"key_poses\.0\.posture: unknown posture 'sitting'; known: start, stand"),
        ("frames: {l_sole: {offset: [0.0, 0.0, 0.1]}}", r"frames\.l_sole: a motion cannot move frame 'l_sole'"),
        ("frames: {torso: {offset: [0.0, 0.0, 0.1], anchor: nose}}", r"frames\.torso\.anchor: .*'nose'"),
        ("frames: {torso: {offset: [0.0, 0.0]}}", r"frames\.torso\.offset"),
        ("frames: {torso: {offset: [0.0, 0.0, 0.1], unit: foot}}", r"frames\.torso\.unit"),
        ("frames: {torso: {offset: [0.0, 0.0, 0.1], axes: zx}}", r"frames\.torso\.axes"),
        ("frames: {torso: {}}", r"frames\.torso: .*give offset, rpy or both"),
        ("frames: {torso: {rpy: [0.0, 0.1, 0.0], settable: true}}", r"frames\.torso: .*need an offset"),
        ("prefer: {g1: {nose_joint: 0.1}}", r"key_poses\.0\.prefer\.g1\.nose_joint: g1 has no joint 'nose_joint'"),
        ("prefer: {g1: {left_knee_joint: 9.0}}", r"prefer\.g1\.left_knee_joint: 9 rad is outside"),
        ("name: again", r"key 'name' is given twice"),
    ],
)
def test_bad_file_is_named_with_its_key(tmp_path: Path, more: str, message: str) -> None:
    path = motion_file(tmp_path, more=more)
    with pytest.raises(ConfigError, match=message) as refusal:
        load_motion(path, load("g1")[0])
    assert str(path) in str(refusal.value)


def test_joint_target_outside_its_limits(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"joints\.g1\.waist_pitch_joint: 0\.6 rad is outside"):
        load_motion(motion_file(tmp_path, pitch=0.6), load("g1")[0])


def test_joint_target_inside_the_margin_is_refused_by_the_plan(tmp_path: Path) -> None:
    model = load("g1")[0]
    planner = MotionPlanner(model, extra=[motion_file(tmp_path, pitch=0.518)])
    with pytest.raises(UnreachableError, match=r"nod, key pose 'down': joint 'waist_pitch_joint' missed by"):
        planner.plan("nod", model.posture("stand"))


@pytest.mark.parametrize("robot", ("g1", "talos"))
def test_example_of_the_documentation_works(robot: str, root: Path, tmp_path: Path) -> None:
    text = (root / "docs" / "motions.md").read_text(encoding="utf-8")
    path = tmp_path / "nod.yaml"
    path.write_text(text.split("```yaml\n")[1].split("```")[0], encoding="utf-8")
    model = load(robot)[0]
    plan = MotionPlanner(model, extra=[path]).plan("nod", model.posture("stand"))
    np.testing.assert_allclose(plan.positions[-1], model.posture("stand"), atol=1e-6)
