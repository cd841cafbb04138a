"""Commands to the robot in lockstep, and when it is damped or does not stand at all."""

from collections.abc import Sequence

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from bridge.loop import lockstep
from controllers.estimation.assembler import mean_sample
from models.errors import CommandError, PoiseError
from models.robot_model import RobotModel
from models.types import Mode, SensorData
from tests.wrapped import Wrapped, columns


def test_text_commands(g1: RobotModel) -> None:
    loop = ClosedLoop(g1)
    assert loop.command("wave").accepted
    assert loop.mode is Mode.MOTION
    busy = loop.command("squat")
    assert not busy.accepted and "wave" in busy.reason
    loop.run(0.5)
    assert loop.command("stop").accepted
    loop.run(0.6)  # it slows down first
    assert loop.mode is Mode.STAND and not loop.controller.motion_active
    assert loop.command("walk").accepted and loop.mode is Mode.WALK
    assert loop.command("stop").accepted
    loop.run(1.5)
    assert loop.mode is Mode.STAND
    assert not loop.command("levitate").accepted
    assert not loop.command("x" * 1000).accepted
    assert max(len(text) for _, text in loop.events) < 300
    assert any("wave" in text for _, text in loop.events)


def test_motion_runs_to_its_end(g1: RobotModel) -> None:
    loop = ClosedLoop(g1, record=False)
    hand = [loop.plant.mujoco.bodies[name] for name in ("l_wrist", "r_wrist")]
    before = loop.data.xpos[hand, 2].copy()
    assert loop.command("wave").accepted
    highest = before.copy()
    while loop.mode is Mode.MOTION:
        loop.step()
        highest = np.maximum(highest, loop.data.xpos[hand, 2])
    assert (highest - before).max() > 0.3
    assert loop.mode is Mode.STAND and not loop.fallen
    assert loop.command("squat").accepted and loop.wait_motion()


def test_velocity_is_refused_unless_it_walks(g1: RobotModel) -> None:
    with pytest.raises(CommandError, match="command 'walk' first"):
        ClosedLoop(g1).set_velocity(0.4, 0.0, 0.0)


def test_topples_damps_and_latches_until_reset(g1: RobotModel) -> None:
    loop = ClosedLoop(g1)
    loop.apply_push((600.0, 0.0, 0.0), 0.2, "torso")
    loop.run(2.0)
    assert loop.fallen and loop.fall_reason
    assert loop.mode is Mode.DAMP
    assert any("tilt" in fault for fault in loop.faults)
    servo = loop._lockstep.servo
    assert servo.state.value == "damped"
    reply = loop.command("wave")
    assert not reply.accepted and "damp" in reply.reason
    assert any(text.startswith("mode damp: fallen") for _, text in loop.events)
    assert np.isfinite(columns(loop)).all()
    loop.reset()
    loop.run(0.2)
    assert loop.mode is Mode.STAND and not loop.fallen and loop.faults == ()


def test_controller_without_an_answer_damps_the_drivers(g1: RobotModel) -> None:
    controller = Wrapped(g1)
    loop = ClosedLoop(g1, controller=controller)
    controller.damped = True
    loop.run(0.02)
    assert loop._lockstep.servo.state.value == "damped"
    assert loop.mode is Mode.DAMP
    assert loop.faults


def test_robot_whose_feet_take_no_weight_is_not_let_go(g1: RobotModel) -> None:
    controller = Wrapped(g1)
    controller.limp = True
    with pytest.raises(PoiseError, match=r"g1 cannot be released after .* s: the feet carry .* N of 327 N"):
        ClosedLoop(g1, controller=controller)


def test_robot_that_fails_the_preflight_checks_does_not_stand(g1: RobotModel, monkeypatch: pytest.MonkeyPatch) -> None:
    knee = g1.joint_index("left_knee_joint")

    def bent(samples: Sequence[SensorData]) -> SensorData:
        mean = mean_sample(samples)
        mean.q[knee] = g1.q_upper[knee] + 0.2
        return mean

    monkeypatch.setattr(lockstep, "mean_sample", bent)
    with pytest.raises(PoiseError, match=r"g1 cannot stand: .*'left_knee_joint' measures"):
        ClosedLoop(g1)
