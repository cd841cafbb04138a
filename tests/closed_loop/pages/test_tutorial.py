"""The code of the tutorial does what it says."""

import re
from pathlib import Path
from typing import Any

import pytest

from bridge.closed_loop import ClosedLoop
from models.robot_model import RobotModel
from planners.library import motion_files
from planners.motion import MotionPlanner


@pytest.fixture
def blocks(root: Path) -> dict[str, str]:
    """Code of the page, by its language."""
    text = (root / "docs/tutorial.md").read_text()
    return dict(re.findall(r"```(\w+)\n(.*?)```", text, re.DOTALL))


def test_the_task_turns_the_waist_and_the_robot_stands(blocks: dict[str, str], capsys: Any) -> None:
    names: dict[str, Any] = {}
    exec(compile(blocks["python"], "tutorial", "exec"), names)
    loop, task = names["loop"], names["task"]
    assert loop.truth.q[7 + task.index] == pytest.approx(0.4, abs=0.05)
    assert not loop.fallen and loop.foot_slip.max() < 0.002
    assert "fallen: False" in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize("name", ["g1", "talos"])
def test_the_motion_fits_every_robot(blocks: dict[str, str], tmp_path: Path, name: str) -> None:
    (tmp_path / "salute.yaml").write_text(blocks["yaml"])
    model = RobotModel.load(name)
    planner = MotionPlanner(model, extra=motion_files(tmp_path))
    trajectory = planner.plan("salute", model.posture("stand"))
    loop = ClosedLoop(model, seed=0)
    loop.run(0.5)
    loop.controller.follow(planner.plan("salute", loop.controller.reference.posture))
    loop.run(float(trajectory.times[-1]) + 1.0)
    assert not loop.fallen and not loop.faults
