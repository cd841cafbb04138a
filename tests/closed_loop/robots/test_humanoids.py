"""Robots of other kinds than the packaged ones, from a generated URDF alone: they stand, squat and walk."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.stability.humanoids import Humanoid
from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from models.proposal.profile_text import write_proposal
from models.proposal.propose import propose
from models.robot_model import RobotModel
from models.types import ContactState, RobotState, SolveStatus
from planners.gait.state import GaitPhase
from planners.gait.strength import leg_limits

KINDS = {
    "five-joint legs": Humanoid(ankle_roll=False),
    "legs below a waist": Humanoid(waist_legs=True),
    "four-joint legs": Humanoid(ankle_roll=False, hip_yaw=False),
    "no hip yaw": Humanoid(hip_yaw=False),
    "weak knees": Humanoid(knee=40.0),
}


def proposed(kind: str, folder: Path) -> RobotModel:
    """The robot with the profile that is proposed for it."""
    return RobotModel.load(write_proposal(propose(KINDS[kind].write(folder)), folder / "mine.yaml")[0])


@pytest.fixture(scope="module")
def five(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """A robot without ankle roll."""
    return proposed("five-joint legs", tmp_path_factory.mktemp("five"))


@pytest.fixture(scope="module", params=KINDS)
def kind(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """Each kind of robot in turn."""
    return proposed(request.param, tmp_path_factory.mktemp("kind"))


def test_legs_are_the_joints_below_those_of_both(five: RobotModel, tmp_path: Path) -> None:
    waist = proposed("legs below a waist", tmp_path)
    for model, shared in ((five, []), (waist, ["waist_yaw", "waist_roll"])):
        for foot in model.feet:
            names = [model.joint_names[i - 6] for i in foot.chain_ids_v]
            assert names[: len(shared)] == shared
            assert [model.joint_names[i - 6] for i in foot.joint_ids_v] == names[len(shared) :]
            assert names[-1] == f"{foot.name}_ankle_{'roll' if model is waist else 'pitch'}"
    assert [foot.free[0] for foot in (*five.feet, *waist.feet)] == [True, True, False, False]
    assert waist.profile.base_link == "trunk" and waist.profile.frames["torso"].link == "trunk"


def test_a_sole_that_rolls_bears_on_its_middle_line_alone(five: RobotModel) -> None:
    """The QP's wrenches have no moment about the line, and a foot in the air is not held against rolling."""
    model, law, contact = five, BalanceController(five), ContactState(active=True, wrench=np.zeros(6))
    still = np.zeros(model.nv), np.zeros(model.nj)
    state = RobotState(0.0, model.standing_configuration(), *still, (contact, contact))
    law.reset(state)
    result = law.step(state, 1e-3)
    assert result.status is SolveStatus.OPTIMAL and result.residual < 1e-6
    for foot, area, wrench in zip(model.feet, law.whole_body.areas, result.wrenches, strict=True):
        assert area[2] == area[3] == 0.5 * (foot.rectangle[2] + foot.rectangle[3])
        assert wrench[2] > 0.2 * 9.81 * model.mass
        assert wrench[3] == pytest.approx(area[2] * wrench[2], abs=1e-6)
    assert [law.whole_body.tasks[f"{foot.name}_foot"].weight[3] for foot in model.feet] == [0.0, 0.0]


def test_legs_of_four_joints_keep_both_soles_and_the_heading(tmp_path: Path) -> None:
    """The contact rows hold in every direction, also in those that the leg leaves alone, and the QP is solved."""
    model, contact = proposed("four-joint legs", tmp_path), ContactState(active=True, wrench=np.zeros(6))
    law, state = (
        BalanceController(model),
        RobotState(0.0, model.standing_configuration(), np.zeros(model.nv), np.zeros(model.nj), (contact, contact)),
    )
    law.reset(state)
    result = law.step(state, 1e-3)
    assert result.status is SolveStatus.OPTIMAL and result.residual < 1e-6
    data, acceleration = model.data(), law.whole_body.acceleration
    pin.computeJointJacobians(model.pin, data, state.q)
    pin.updateFramePlacements(model.pin, data)
    for foot in model.feet:
        twist = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.LOCAL) @ acceleration
        assert np.abs(np.delete(twist, 3)).max() < 1e-6  # about its length it may turn
    assert np.abs(acceleration[[0, 1, 2, 4]]).max() < 1.0 and abs(acceleration[5]) < 1e-6


def test_a_robot_without_yaw_says_that_it_does_not_turn(tmp_path: Path) -> None:
    loop = ClosedLoop(proposed("four-joint legs", tmp_path), seed=1)
    loop.run(0.3)
    reply = loop.command("turn")
    assert reply.accepted and "turn 0.4 limited to 0 rad/s by the legs" in reply.reason


@pytest.mark.long
def test_weak_knees_squat_and_walk_within_their_torque(tmp_path: Path) -> None:
    model = proposed("weak knees", tmp_path)
    bend = model.posture("stand")[model.joint_index("left_knee")]
    assert 0.25 <= bend < 0.45
    loop = ClosedLoop(model, seed=1)
    loop.run(0.3)
    reply = loop.command("squat")
    assert reply.details == {"size": pytest.approx(0.8, abs=0.11)} and "of its size" in reply.reason
    assert loop.wait_motion() and not loop.fallen


@pytest.mark.long
def test_stands_and_squats(kind: RobotModel) -> None:
    loop = ClosedLoop(kind, seed=1)
    start, height = loop.plant.com.copy(), float(loop.truth.q[2])
    loop.run(1.0)
    assert np.abs(loop.plant.com - start)[:2].max() < 0.01
    assert loop.command("squat").accepted and loop.wait_motion()
    assert not loop.fallen and height - float(loop.log.true_q[:, 2].min()) > 0.08
    assert loop.foot_slip.max() < 0.005


@pytest.mark.long
def test_walks_forward_and_stands_again(kind: RobotModel) -> None:
    loop = ClosedLoop(kind, seed=1)
    loop.command("walk")
    loop.set_velocity(0.3, 0.0, 0.0)
    loop.run(4.0)
    loop.command("stop")
    loop.run(2.5)
    assert not loop.fallen and loop.mode.value == "stand"
    assert 0.7 < loop.truth.q[0] < 1.5 and abs(loop.truth.q[1]) < 0.3


@pytest.mark.long
def test_a_walking_knee_bears_what_the_nominal_step_says(tmp_path: Path) -> None:
    """At the velocity that weak knees allow they bear what is allowed, and are seldom at their limit."""
    loop = ClosedLoop(proposed("weak knees", tmp_path), seed=3, record=False)
    state, config = loop.gait.state, loop.gait.config
    knees = [loop.robot.joint_index(f"{foot.name}_knee") for foot in loop.robot.feet]
    assert leg_limits(loop.robot, config)["forward"] == "joint 'left_knee' of 40 N.m"
    loop.command("walk")
    loop.set_velocity(config.velocity.forward, 0.0, 0.0)
    loop.run(4.0)
    shares = []
    for _ in range(2000):
        loop.run(0.002)
        if state.phase is GaitPhase.SINGLE:
            knee = knees[state.stance]
            shares.append(abs(loop.stack.result.command.tau[knee]) / loop.robot.tau_max[knee])
    assert np.sqrt(np.mean(np.square(shares))) == pytest.approx(config.torque_share, rel=0.15)
    assert np.mean(np.array(shares) > 0.95) < 0.15


@pytest.mark.parametrize("direction", [0.0, *(pytest.param(way, marks=pytest.mark.long) for way in (90.0, 180.0))])
def test_a_push_does_not_fell_it(kind: RobotModel, direction: float) -> None:
    loop = ClosedLoop(kind, seed=2)
    loop.run(0.5)
    force = 0.3 * kind.mass / 0.1  # 0.3 m/s in 0.1 s
    angle = np.radians(direction)
    loop.apply_push((force * float(np.cos(angle)), force * float(np.sin(angle)), 0.0), duration=0.1, body="base_link")
    loop.run(4.0)
    assert not loop.fallen and loop.mode.value == "stand"


@pytest.fixture(scope="module")
def weak(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """A robot of 45 kg with ankles of 8 N.m, which hold the CoP within 4 cm of the ankle."""
    folder = tmp_path_factory.mktemp("weak")
    return RobotModel.load(write_proposal(propose(Humanoid(ankle=8.0).write(folder)), folder / "mine.yaml")[0])


def test_a_sole_bears_where_the_ankle_holds_the_cop(weak: RobotModel, five: RobotModel, g1: RobotModel) -> None:
    reach = 8.0 / (0.5 * 9.81 * weak.mass)
    for foot in weak.feet:
        assert foot.bearing[:2] == pytest.approx((-reach, reach), abs=2e-3)
        assert foot.rectangle[0] < foot.bearing[0] and foot.bearing[1] < foot.rectangle[1]
    assert [foot.bearing for foot in g1.feet] == [foot.rectangle for foot in g1.feet]
    assert five.feet[0].bearing[2] == five.feet[0].bearing[3]
    data = weak.data()
    com = pin.centerOfMass(weak.pin, data, weak.standing_configuration())
    assert abs(com[0] - 0.5 * (weak.feet[0].bearing[0] + weak.feet[0].bearing[1])) < 3e-3


@pytest.mark.long
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_weak_ankles_do_not_fell_a_pushed_robot(weak: RobotModel, way: float) -> None:
    loop = ClosedLoop(weak, seed=1)
    loop.run(0.5)
    loop.apply_push((way * 0.25 * weak.mass / 0.1, 0.0, 0.0), duration=0.1, body="base_link")
    loop.run(4.0)
    assert not loop.fallen and loop.mode.value == "stand"
