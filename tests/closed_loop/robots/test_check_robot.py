"""``poise check-robot``: robots without a hand-written profile stand and wave; the verdict says why others do not."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.stability.humanoids import Humanoid
from bridge.check_robot import Trial, TrialConfig, Trials, Verdict, check_robot, shortened
from bridge.cli import app
from bridge.closed_loop import ClosedLoop
from models.config import default_config
from models.profile import load_profile
from models.proposal.profile_text import write_proposal
from models.proposal.propose import propose
from models.robot_model import RobotModel
from models.urdf import data_folder

RUNNER = CliRunner()
ROBOTS = data_folder() / "robots"
ICUB = ROBOTS / "icub_description/robots/icub.urdf"
ROMEO = ROBOTS / "romeo_description/urdf/romeo_small.urdf"


def test_a_robot_without_feet_is_refused_by_name(tmp_path: Path) -> None:
    urdf = ROBOTS / "alex_description/urdf/alex_nub_hands.urdf"
    result = RUNNER.invoke(app, ["check-robot", str(urdf), "--out", str(tmp_path / "alex.yaml")])
    assert result.exit_code == 2
    assert "no feet" in result.output and not (tmp_path / "alex.yaml").exists()


def test_a_profile_is_not_overwritten_unasked(tmp_path: Path) -> None:
    out = tmp_path / "icub.yaml"
    out.write_text("mine")
    result = RUNNER.invoke(app, ["check-robot", str(ICUB), "--out", str(out)])
    assert result.exit_code == 2 and "--overwrite" in result.output and out.read_text() == "mine"


def test_the_verdict_asks_for_standing_and_waving(g1: RobotModel) -> None:
    proposal = propose(g1.urdf)

    def passed(**done: bool) -> bool:
        return Verdict(proposal, (), tuple(Trial(name, well, "") for name, well in done.items())).passed

    assert passed(stand=True, wave=True) and passed(stand=True, squat=False, wave=True, walk=False)
    assert not passed(stand=True, wave=False) and not passed(stand=False, wave=True) and not passed(stand=True)


def test_a_robot_without_arms_need_not_wave(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []
    monkeypatch.setattr(Trials, "_try", lambda self, name, trial: tried.append(name) or Trial(name, True, ""))
    verdict = check_robot(Humanoid(arms=()).write(tmp_path), tmp_path / "mine.yaml")
    assert tried == ["stand", "squat", "walk", "push"] and verdict.passed and verdict.needed == ("stand",)


def test_long_lists_are_cut() -> None:
    assert shortened("joints 'a', 'b', 'c', 'd', 'e'") == "joints 'a', 'b', 'c', 'd', 'e'"
    assert shortened("joints 'a', 'b', 'c', 'd', 'e', 'f'") == "joints 'a', 'b', 'c', 'd' and 2 more"


def test_a_proposed_robot_that_can_only_just_be_built_stands(tmp_path: Path) -> None:
    """iCub, from a URDF with a base that looks backward, links without inertia and meshes that MuJoCo cannot read."""
    files = write_proposal(propose(ICUB), tmp_path / "icub.yaml")
    loop = ClosedLoop(files[0], seed=1)
    start = loop.plant.com.copy()
    loop.run(0.5)
    assert not loop.fallen and loop.mode.value == "stand"
    assert abs(loop.plant.com - start).max() < 0.005


@pytest.mark.slow
@pytest.mark.parametrize(("urdf", "limit"), [(ICUB, None), (ROMEO, "joint 'LKneePitch' of 38.2 N.m: crouch")])
def test_a_new_robot_does_every_trial(urdf: Path, limit: str | None, tmp_path: Path) -> None:
    """Romeo has knees of 38 N.m for 40 kg: it walks with straighter legs, and the report says why."""
    out = tmp_path / "new.yaml"
    result = RUNNER.invoke(app, ["check-robot", str(urdf), "--out", str(out)], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    lines = [line for line in result.output.splitlines() if line.startswith("│")]
    words = {cells[1].strip(): cells[2].strip() for cells in (line.split("│") for line in lines) if len(cells) > 3}
    assert [words[name] for name in ("draw", "stand", "squat", "wave", "walk", "push")] == ["done"] * 6
    assert load_profile(out).joints
    said = "the walk is limited by " in result.output
    assert said is (limit is not None) and (limit is None or f"the walk is limited by {limit}" in result.output)


def test_a_robot_too_weak_to_stand_is_reported(tmp_path: Path) -> None:
    """The proposal for iCub with knees of a tenth of the torque that standing takes."""
    files = write_proposal(propose(ICUB), tmp_path / "icub.yaml")
    text = files[0].read_text()
    for side in "lr":
        knee = f"  {side}_knee: {{motor: "
        assert knee in text
        text = text.replace(knee, f"  {side}_knee: {{torque_limit: 0.5, motor: ")
    files[0].write_text(text)
    trials = Trials(RobotModel.load(files[0]), default_config(TrialConfig, "bridge", "check_robot")).run()
    assert [trial.name for trial in trials] == ["stand"] and not trials[0].passed
    assert "cannot be released" in trials[0].detail


@pytest.mark.slow
def test_a_failure_names_the_joint_at_its_limit_in_that_trial(g1: RobotModel) -> None:
    config = default_config(TrialConfig, "bridge", "check_robot")
    short = replace(config, stand_time=0.1, pause=0.1, walk_time=0.3, stop_time=0.3, stride_min=100.0, at_limit=0.1)
    walk = next(trial for trial in Trials(g1, short).run() if trial.name == "walk")
    before = re.search(r"was the first at its torque limit of [\d.]+ N.m, ([\d.]+) s before the end", walk.detail)
    assert walk.name == "walk" and not walk.passed and before is not None
    assert float(before[1]) <= short.walk_time + short.stop_time


def test_check_robot_returns_what_it_wrote(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, g1: RobotModel) -> None:
    monkeypatch.setattr(Trials, "run", lambda self: [Trial("stand", True, "")])
    verdict = check_robot(g1.urdf, tmp_path / "g1.yaml")
    assert verdict.files == (tmp_path / "g1.yaml",) and not verdict.passed
    assert [trial.name for trial in verdict.trials] == ["draw", "stand"] and verdict.trials[0].passed
