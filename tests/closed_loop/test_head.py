"""The head turns while the robot stands, moves and walks; a recorded run with it is reproduced."""

from pathlib import Path

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from bridge.record.run_file import read_run
from bridge.replay.replay import replay
from models.errors import CommandError
from models.robot_model import RobotModel
from models.types import Mode


@pytest.mark.slow
@pytest.mark.ros
def test_talos_turns_its_head_standing_waving_and_walking(talos: RobotModel, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    head = talos.profile.head
    assert head is not None
    joints = [7 + talos.joint_index(name) for name in (head.pan, head.tilt)]
    with ClosedLoop(robot=talos, seed=3, record=False, mcap=path) as loop:

        def off(pan: float, tilt: float) -> float:
            """How far the head is from two angles [rad]."""
            return float(np.abs(loop.truth.q[joints] - [pan, tilt]).max())

        loop.look(0.8, 0.3)
        loop.run(1.0)
        assert loop.command("wave").accepted  # planned from the posture below: a turning head refuses no motion
        loop.run(0.5)
        loop.look(-0.6, 0.1)  # newer than the motion
        assert loop.wait_motion() and off(-0.6, 0.1) < 0.03
        assert loop.command("walk").accepted
        loop.set_velocity(0.25, 0.0, 0.0)
        loop.run(1.5)
        loop.look(9.0, -9.0)
        loop.run(3.0)
        assert off(talos.q_upper[joints[0] - 7], talos.q_lower[joints[1] - 7]) < 0.05
        assert loop.gait.steps > 2
        loop.command("stop")
        loop.run(3.0)
        assert loop.mode is Mode.STAND and not loop.fallen and not loop.faults
        loop.look(0.0, 0.0)
        loop.run(3.0)
        assert off(0.0, 0.0) < 0.03 and loop.foot_slip.max() < 0.01
    report = replay(read_run(path))
    assert report.identical and report.compared > 10_000


def test_a_robot_whose_head_is_fixed_refuses(g1: RobotModel) -> None:
    loop = ClosedLoop(g1, record=False)
    with pytest.raises(CommandError, match="no movable head"):
        loop.look(0.1, 0.1)
    loop.apply_push((600.0, 0.0, 0.0), 0.2, "torso")
    loop.run(1.5)
    with pytest.raises(CommandError, match="head refused in mode 'damp'"):
        loop.look(0.1, 0.1)
