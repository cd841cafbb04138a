"""Nothing compiles while a robot stands, walks and maps: that takes longer than the drivers wait for a command.

Nor does numba find out the type of an argument in Python, which takes longer than most kernels.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import json, sys
from collections import Counter
from unittest.mock import patch
from numba.core.dispatcher import _DispatcherBase
from bridge.closed_loop import ClosedLoop

def specialisations():
    found = {}
    for module in list(sys.modules.values()):
        if getattr(module, "__name__", "").split(".")[0] in ("models", "planners", "controllers", "bridge"):
            for name, value in list(vars(module).items()):
                if hasattr(value, "signatures") and hasattr(value, "py_func"):
                    found[f"{value.__module__}.{value.__name__}"] = len(value.signatures)
    return found

slow, find_type = Counter(), _DispatcherBase.typeof_pyval

def typeof_pyval(kernel, value):
    slow[f"{kernel.py_func.__name__}: {type(value).__name__}"] += 1
    return find_type(kernel, value)

def find_new(robot):
    seeing = robot == "g1"
    loop = ClosedLoop(robot, record=False, terrain_map=seeing)
    loop.gait  # built when first asked for
    before = specialisations()
    with patch.object(_DispatcherBase, "typeof_pyval", typeof_pyval):
        move(loop)
    if seeing:
        assert loop.ground_view.mapper.patches()
    return {name: n for name, n in specialisations().items() if n != before.get(name)}

def move(loop):
    loop.run(0.2)
    assert loop.command("squat").accepted
    loop.run(0.5)
    loop.apply_push((0.0, 1.5 * loop.robot.mass, 0.0), duration=0.1)
    assert loop.wait_motion()
    loop.run(0.5)
    assert loop.command("wave").accepted
    loop.run(0.5)
    assert loop.command("stop").accepted
    loop.run(0.2)
    assert loop.command("walk").accepted
    loop.set_velocity(0.2, 0.0, 0.0)
    loop.run(2.0)
    assert loop.gait.steps > 0 and not loop.fallen
    assert loop.command("stop").accepted
    loop.run(1.0)

new = {robot: find_new(robot) for robot in ("g1", "talos")}
print(json.dumps({"functions": len(specialisations()), "new": new, "slow": slow}))
"""


@pytest.mark.long
def test_motion_push_and_walk_compile_nothing(root: Path) -> None:
    """Counted in a fresh process, since what an earlier test compiled stays compiled."""
    result = subprocess.run(
        [sys.executable, "-c", SCRIPT], cwd=root, capture_output=True, text=True, timeout=300, check=False
    )
    assert result.returncode == 0, result.stderr[-2000:]
    answer = json.loads(result.stdout.splitlines()[-1])
    assert answer["functions"] > 10
    assert answer["new"] == {"g1": {}, "talos": {}}
    assert answer["slow"] == {}
