"""Routes in the loop: to a pose, over listed footsteps, ended half-way. Estimator on, sensor noise on, 2 ms delay."""

import math

import numpy as np
import pinocchio as pin
import pytest

from bridge.closed_loop import ClosedLoop
from models.errors import CommandError, UnreachableError
from models.types import Mode
from planners.gait.footsteps import Foothold, middle
from planners.gait.route import Footstep
from tests.support import run_until_still


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    made = ClosedLoop("g1", seed=7, record=False)
    assert made.command("walk").accepted
    made.run(0.2)
    return made


def standing(loop: ClosedLoop) -> Foothold:
    """Where the robot stands, by its own measurement."""
    return middle(loop.gait.footholds)


@pytest.mark.long
def test_it_walks_to_a_pose_though_it_is_pushed_and_stands_there(loop: ClosedLoop) -> None:
    x, y = standing(loop).moved(0.3, 0.05)
    yaw = standing(loop).yaw + 0.4
    loop.gait.walk_to(Foothold(x, y, yaw))
    loop.run(1.5)
    loop.apply_push((0.0, 10.0 * 0.15 * loop.robot.mass, 0.0), 0.1)  # N: 0.15 m/s in 0.1 s
    run_until_still(loop, 12.0)
    assert loop.gait.route.outcome == "done"
    there = standing(loop)
    assert math.hypot(there.x - x, there.y - y) < 0.03
    assert there.yaw == pytest.approx(yaw, abs=0.05)


def test_it_takes_listed_footsteps_and_refuses_others_while_it_does(loop: ClosedLoop) -> None:
    here, half = standing(loop), 0.5 * loop.gait.config.reach.width
    holds = [(1, 0.15, -half), (0, 0.25, half + 0.03), (1, 0.25, -half + 0.03)]
    steps = [Footstep(foot, Foothold(*here.moved(along, left), here.yaw)) for foot, along, left in holds]
    bad = [Footstep(1, Foothold(*here.moved(0.1, half), here.yaw))]
    with pytest.raises(UnreachableError, match="cross"):
        loop.gait.take_steps(bad)
    before = loop.gait.steps
    loop.gait.take_steps(steps)
    loop.run(0.3)
    with pytest.raises(CommandError, match="the robot walks"):
        loop.gait.take_steps(steps)
    run_until_still(loop, 6.0)
    assert loop.gait.steps - before == 3
    for hold, expected in zip(loop.gait.footholds, (steps[1], steps[2]), strict=True):
        assert np.hypot(hold.x - expected.hold.x, hold.y - expected.hold.y) < 0.03


def test_a_velocity_or_a_stop_ends_a_route(loop: ClosedLoop) -> None:
    here = standing(loop)
    loop.gait.walk_to(Foothold(*here.moved(3.0, 0.0), here.yaw))
    loop.run(1.5)
    loop.set_velocity(0.0, 0.0, 0.0)
    assert loop.gait.route.left  # zero, as a joystick repeats it, is no reason to give up
    steps = loop.gait.steps
    assert loop.command("stop").accepted
    loop.run(2.5)
    assert loop.mode is Mode.STAND and loop.gait.steps - steps <= 2
    assert loop.gait.route.outcome == "stopped"


@pytest.mark.long
def test_it_waves_while_it_walks(loop: ClosedLoop) -> None:
    if loop.mode is not Mode.WALK:
        assert loop.command("walk").accepted
    loop.set_velocity(0.2, 0.0, 0.0)
    loop.run(1.0)  # under way
    assert "only: wave" in loop.command("squat").reason
    assert loop.command("wave").accepted
    start, data, hand = loop.truth.q[:2].copy(), loop.robot.data(), []
    wrist, base = loop.robot.frame_id("r_wrist"), loop.robot.frame_id("base_link")
    for _ in range(20):
        loop.run(0.1)
        pin.framesForwardKinematics(loop.robot.pin, data, loop.truth.q)
        hand.append(data.oMf[base].actInv(data.oMf[wrist]).translation.copy())
    assert loop.mode is Mode.WALK and not loop.fallen
    assert np.ptp(hand, axis=0)[2] > 0.3  # [m] up beside the head
    assert 0.3 < np.hypot(*(loop.truth.q[:2] - start)) < 0.5  # and the legs have gone on
    assert loop.command("stop").accepted
    loop.run(3.0)
    assert loop.mode is Mode.STAND and not loop.fallen
    assert np.abs(loop.truth.q[7:] - loop.robot.posture("stand")).max() < 0.15  # the arm is down again
