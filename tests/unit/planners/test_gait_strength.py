"""What the legs' torques allow of a walk: crouch and velocity limits, and the joint that is named as their cause."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.stability.humanoids import Humanoid
from models.config import default_config
from models.proposal.config import ProposalConfig
from models.proposal.profile_text import write_proposal
from models.proposal.propose import propose
from models.robot_model import RobotModel
from models.types import STILL
from planners.gait.commands import exceeded
from planners.gait.config import GaitConfig
from planners.gait.pace import pace_at
from planners.gait.scaling import load_gait_config
from planners.gait.strength import STANDSTILL, StepLoads, leg_limits, within_legs

Build = Callable[[Humanoid], RobotModel]


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """A generated robot with the profile that is proposed for it, knees bent by 0.5 rad whatever their torque."""
    config = default_config(ProposalConfig, "models", "proposal")
    bent = replace(config, posture=replace(config.posture, torque_share=0.999))

    def _build(robot: Humanoid) -> RobotModel:
        folder: Path = tmp_path_factory.mktemp("robot")
        return RobotModel.load(write_proposal(propose(robot.write(folder), config=bent), folder / "mine.yaml")[0])

    return _build


def test_strong_legs_are_not_limited(g1: RobotModel, build: Build) -> None:
    for model in (g1, build(Humanoid())):
        config = load_gait_config(model)
        assert leg_limits(model, config) == {}
        assert within_legs(model, replace(config, torque_share=0.99)) == replace(config, torque_share=0.99)
    assert load_gait_config(g1).velocity.forward == pytest.approx(1.25, abs=1e-3)


def test_talos_is_as_fast_as_its_hips(talos: RobotModel) -> None:
    """At 1.2 m/s it falls within 7 s, both hips at their limits; at 1.1 m/s it walks on."""
    config = load_gait_config(talos)
    assert 1.0 < config.velocity.forward < 1.15 and config.pace.forward == pytest.approx(1.3, abs=0.05)
    assert leg_limits(talos, config) == {"forward": "joint 'leg_left_3_joint' of 160 N.m"}


def test_weaker_knees_crouch_less_and_walk_slower(build: Build) -> None:
    robots = [build(Humanoid(knee=knee)) for knee in (200.0, 60.0, 45.0, 40.0)]
    gaits = [load_gait_config(model) for model in robots]
    for name in ("slow", "fast"):
        crouches = [getattr(gait.pace, name).crouch for gait in gaits]
        assert crouches == sorted(crouches, reverse=True) and crouches[0] > 0.03 and crouches[-1] < 0.01
    places = [gait.zmp for gait in gaits]  # from under the ankle to the middle of the sole
    assert places == sorted(places) and places[0] == pytest.approx(0.3) and places[-1] == 1.0
    speeds = [gait.velocity.forward for gait in gaits]
    assert speeds == sorted(speeds, reverse=True) and speeds[0] > 1.2 and 0.1 < speeds[-1] < 0.6
    for model, gait in zip(robots[1:], gaits[1:], strict=True):
        assert leg_limits(model, gait)["forward"] == f"joint 'left_knee' of {_knee(model):g} N.m"


def test_a_gait_is_that_of_the_urdf_that_was_loaded(build: Build) -> None:
    """The gaits of a process are kept, by profile and URDF."""
    weak = build(Humanoid(knee=45.0))
    weak.urdf.write_text(weak.urdf.read_text().replace('effort="45.0"', 'effort="200.0"'))
    strong = RobotModel.load(weak.profile.source)
    assert (_knee(weak), _knee(strong)) == (45.0, 200.0)
    assert load_gait_config(weak).velocity.forward < 0.7 * load_gait_config(strong).velocity.forward


def _knee(model: RobotModel) -> float:
    return float(model.tau_max[model.joint_index("left_knee")])


def test_a_limit_is_where_the_load_is_what_is_allowed(build: Build) -> None:
    model = build(Humanoid(knee=45.0))
    config = load_gait_config(model)
    loads = StepLoads(model, config)
    assert loads.excess((config.velocity.forward, 0.0, 0.0))[0] <= 1.0
    assert loads.excess((1.02 * config.velocity.forward, 0.0, 0.0))[0] > 1.0
    slow = pace_at(0.0, config.pace)
    deeper = slow._replace(crouch=slow.crouch + 0.002)
    assert StepLoads(model, config, 0.9).excess(STILL, deeper)[0] > 1.0
    # Twice the torque, half the share.
    strong = StepLoads(build(Humanoid(knee=90.0)), config)
    shares = loads.shares(STILL, slow).max(), strong.shares(STILL, slow).max()
    assert shares[0] == pytest.approx(2.0 * shares[1], rel=1e-3)


def test_on_the_spot_the_knee_bears_what_standing_on_it_takes(build: Build) -> None:
    """Bent by 0.5 rad, one leg takes 27 N.m of the 45 kg robot's knee: statics with a point under the CoM."""
    model = build(Humanoid(knee=50.0))
    config = load_gait_config(model)
    upright = pace_at(0.0, config.pace)._replace(crouch=0.0)
    assert StepLoads(model, config).shares(STILL, upright).max() == pytest.approx(27.0 / 50.0, rel=0.2)


def test_a_robot_that_cannot_bear_itself_on_one_leg_does_not_walk(build: Build) -> None:
    model = build(Humanoid(knee=22.0))
    limits = load_gait_config(model).velocity
    assert [limits.forward, limits.backward, limits.lateral, limits.turn] == [STANDSTILL] * 4


@pytest.mark.parametrize("robot", [Humanoid(hip_yaw=False), Humanoid(hip_yaw=False, ankle_roll=False)])
def test_legs_without_yaw_do_not_turn(build: Build, robot: Humanoid) -> None:
    model = build(robot)
    config = load_gait_config(model)
    assert config.velocity.turn == config.route.turn == STANDSTILL and config.velocity.forward > 1.0
    assert "do not turn their soles" in leg_limits(model, config)["turn"]


def test_what_a_velocity_exceeds_is_said_with_the_cause(g1: RobotModel) -> None:
    config: GaitConfig = load_gait_config(g1)
    causes = {"backward": "joint 'a' of 9 N.m", "turn": "the legs"}
    said = exceeded((-9.0, 0.1, 3.0), config.velocity, causes)
    assert said == {
        "forward": "forward -9 limited to -0.4 m/s by joint 'a' of 9 N.m",
        "turn": "turn 3 limited to 0.8 rad/s by the legs",
    }
    assert exceeded((9.0, 0.0, 0.0), config.velocity, causes) == {"forward": "forward 9 limited to 1.25 m/s"}
    assert exceeded(STILL, config.velocity, causes) == {}


def test_mirrored_velocities_take_as_much(g1: RobotModel) -> None:
    loads = StepLoads(g1, load_gait_config(g1))
    left, right = (loads.shares((0.0, sign * 0.2, 0.0)) for sign in (1.0, -1.0))
    np.testing.assert_allclose(left, right)


def test_slow_hips_limit_the_turn(tmp_path: Path) -> None:
    """Each hip turns by w T in the single support T_s, along a cubic with the mean square (6 / 5) (w T / T_s)^2."""
    proposal = propose(Humanoid().write(tmp_path))
    joints = dict(proposal.profile.joints)
    for side in ("left", "right"):
        joints[f"{side}_hip_yaw"] = replace(joints[f"{side}_hip_yaw"], velocity_limit=0.4)
    slow = replace(proposal, profile=replace(proposal.profile, joints=joints))
    model = RobotModel.load(write_proposal(slow, tmp_path / "slow.yaml")[0])
    config = load_gait_config(model)
    pace = pace_at(0.0, config.pace)
    turn = config.swing.speed_share * 0.4 * pace.single / (pace.period * np.sqrt(1.2))
    assert config.velocity.turn == pytest.approx(turn, rel=0.03)
    assert "hip_yaw' of 0.4 rad/s" in leg_limits(model, config)["turn"]
    assert config.velocity.forward > 1.2
