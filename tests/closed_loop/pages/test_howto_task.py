"""The code of the page on tasks does what the page says, and so does the task that needs only configuration."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from controllers.whole_body.config import PointTask, WholeBodyConfig
from controllers.whole_body.tasks import FramePositionTask
from models.config import default_config
from models.robot_model import RobotModel


@pytest.mark.long
def test_the_hand_is_where_it_shall_be(root: Path, capsys: Any) -> None:
    code = re.findall(r"```python\n(.*?)```", (root / "docs/howto_task.md").read_text(), re.DOTALL)[0]
    names: dict[str, Any] = {}
    exec(compile(code, "howto_task", "exec"), names)
    assert names["estimated"] < 1.0 and names["real"] < 3.0  # [mm]
    assert "fallen: False" in capsys.readouterr().out


@pytest.mark.long
def test_a_configured_task_does_the_same() -> None:
    model = RobotModel.load("talos")
    config = default_config(WholeBodyConfig, "controllers", "whole_body")
    config = dataclasses.replace(config, tasks={"right_hand": PointTask("r_wrist", 400.0, 40.0, 3000.0)})
    controller = BalanceController(model, whole_body=config)
    loop = ClosedLoop(model, controller=controller, record=False)
    loop.run(0.5)
    task, terms = controller.whole_body.tasks["right_hand"], controller.whole_body.terms
    assert isinstance(task, FramePositionTask) and not task.active
    start = terms.frames["r_wrist"].position.copy()
    for k in range(1000):
        task.desired = start + np.array([0.15, 0.05, 0.25]) * (k + 1) / 1000
        loop.step()
    loop.run(2.0)
    assert np.linalg.norm(task.error) < 1e-3
    assert not loop.fallen
