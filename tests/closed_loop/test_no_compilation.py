"""Nothing compiles while the robot stands: a compilation takes longer than the drivers wait for a command."""

from __future__ import annotations

import sys

from bridge.closed_loop import ClosedLoop
from models.robot_model import RobotModel


def _specialisations() -> dict[str, int]:
    """Number of compiled signatures of every numba function that is loaded."""
    return {
        f"{module.__name__}.{name}": len(value.signatures)
        for module in list(sys.modules.values())
        if getattr(module, "__name__", "").split(".")[0] in ("models", "controllers", "bridge")
        for name, value in list(vars(module).items())
        if hasattr(value, "signatures") and hasattr(value, "py_func")
    }


def test_motion_and_push_compile_nothing(robot: RobotModel) -> None:
    loop = ClosedLoop(robot, record=False)
    before = _specialisations()
    assert sum(before.values()) > 10
    loop.run(0.2)
    assert loop.command("squat").accepted
    loop.run(0.5)
    loop.apply_push((0.0, 1.5 * robot.mass, 0.0), duration=0.1)
    assert loop.wait_motion()
    loop.run(0.5)
    assert loop.command("stop").accepted
    loop.run(0.1)
    assert _specialisations() == before
