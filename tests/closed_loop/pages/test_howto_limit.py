"""The code of the page on limits does what the page says, and so does the limit that needs only configuration."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest

from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from controllers.whole_body.config import HeightLimit, WholeBodyConfig
from models.config import default_config
from models.robot_model import RobotModel


def test_the_com_stays_below_the_ceiling(root: Path, capsys: Any) -> None:
    code = re.findall(r"```python\n(.*?)```", (root / "docs/howto_limit.md").read_text(), re.DOTALL)[0]
    names: dict[str, Any] = {}
    exec(compile(code, "howto_limit", "exec"), names)
    assert names["after"] == pytest.approx(names["limit"].height, abs=1e-3)
    assert names["before"] - names["after"] > 0.025
    assert "fallen: False" in capsys.readouterr().out


@pytest.mark.long
def test_a_configured_height_is_kept() -> None:
    """A squat goes no lower."""
    model = RobotModel.load("talos")
    config = default_config(WholeBodyConfig, "controllers", "whole_body")
    lowest = {}
    for minimum in (0.3, 0.82):
        limits = dataclasses.replace(config.limits, com_height=HeightLimit(True, minimum, 1.5))
        controller = BalanceController(model, whole_body=dataclasses.replace(config, limits=limits))
        loop = ClosedLoop(model, controller=controller, record=False)
        loop.run(0.5)
        assert loop.command("squat").accepted
        terms, heights = controller.whole_body.terms, []
        for _ in range(2000):
            loop.step()
            heights.append(float(terms.com[2] - min(sole.position[2] for sole in terms.soles)))
        lowest[minimum] = min(heights)
        assert not loop.fallen
    assert lowest[0.3] < 0.80
    assert lowest[0.82] == pytest.approx(0.82, abs=2e-3)
