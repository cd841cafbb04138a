"""Pan and tilt: limits and no jolt whatever is commanded, and an untouched posture without a command."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from controllers.balance.head import Head, HeadConfig
from controllers.stack import ControlStack
from models.config import default_config
from models.errors import CommandError, ConfigError
from models.profile import Head as HeadJoints
from models.robot_model import RobotModel
from models.types import JointTrajectory

DT = 0.001


class Played:
    """Runs a head on a posture that may move, and keeps position, velocity and acceleration of its joints."""

    def __init__(self, model: RobotModel) -> None:
        self.model, self.head = model, Head(model)
        self.config = default_config(HeadConfig, "controllers", "head")
        self.posture, self.velocity = model.posture("stand").copy(), np.zeros(model.nj)
        self.zero = np.zeros(model.nj)
        self.rows: list[np.ndarray] = []

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.posture = self.posture + self.velocity * DT
            moved = self.head.step(self.posture, self.velocity, self.zero, DT)
            self.rows.append(np.array([each[self.head.joints] for each in moved]))

    @property
    def series(self) -> np.ndarray:
        """(n, 3, 2)."""
        return np.array(self.rows)


def test_without_a_command_the_posture_is_passed_on_as_it_is(talos: RobotModel) -> None:
    played = Played(talos)
    given = (played.posture, played.velocity, played.zero)
    assert all(a is b for a, b in zip(played.head.step(*given, DT), given, strict=True))
    assert not played.head.active


def test_whatever_is_commanded_the_head_stays_within_its_limits_and_jolts_nowhere(talos: RobotModel) -> None:
    played, rng = Played(talos), np.random.default_rng(2)
    low, high = talos.q_lower[played.head.joints], talos.q_upper[played.head.joints]
    for _ in range(60):
        wild = rng.choice([-1e9, -3.0, -0.5, 0.0, 0.1, 2.0, 1e9], size=2)
        played.head.command(*wild)
        played.run(float(rng.choice([0.001, 0.02, 0.3])))
    q, v, a = np.moveaxis(played.series, 1, 0)
    config = played.config
    assert (q >= low + config.limit_margin - 1e-12).all() and (q <= high - config.limit_margin + 1e-12).all()
    assert np.abs(v).max() <= config.speed and np.abs(np.diff(q, axis=0)).max() <= config.speed * DT
    assert np.abs(np.diff(q, axis=0)).max() > 0.5 * config.speed * DT  # it does move
    assert np.abs(a).max() <= 2.0 * config.speed * config.bandwidth
    assert np.abs(np.diff(v, axis=0)).max() <= 2.0 * config.speed * config.bandwidth * DT
    assert np.abs(np.diff(a, axis=0)).max() <= 4.0 * config.speed * config.bandwidth**2 * DT  # jerk
    assert np.abs(np.gradient(q, DT, axis=0) - v)[1:-1].max() < 0.02 * config.speed
    assert np.abs(np.gradient(v, DT, axis=0) - a)[1:-1].max() < 0.05 * config.speed * config.bandwidth


def test_it_arrives_rests_and_keeps_the_velocity_that_it_is_given(talos: RobotModel) -> None:
    played = Played(talos)
    played.head.command(0.5, 0.2)
    played.run(4.0)
    posture, velocity, _ = played.head.step(played.posture, played.zero, played.zero, DT)
    np.testing.assert_array_equal(posture[played.head.joints], [0.5, 0.2])
    assert velocity is played.zero  # at rest nothing has to be computed anew
    others = np.delete(np.arange(talos.nj), played.head.joints)
    np.testing.assert_array_equal(posture[others], played.posture[others])


def test_a_motion_takes_the_head_over_without_a_jump_and_leaves_it_untouched(talos: RobotModel) -> None:
    played = Played(talos)
    pan = played.head.joints[0]
    played.head.command(0.6, 0.1)
    played.run(4.0)
    arm = JointTrajectory(("arm_left_1_joint",), np.array([1.0]), np.zeros((1, 1)))
    played.head.release(arm)
    played.run(0.1)
    assert played.rows[-1][0, 0] == 0.6  # it does not move the head: nothing changes
    played.velocity[pan] = -0.4  # the posture below begins to turn the head by itself
    played.head.release(replace(arm, joint_names=("head_2_joint",)))
    played.run(0.5)
    played.velocity = np.zeros(talos.nj)
    played.run(3.0)
    q, v, _ = np.moveaxis(played.series, 1, 0)
    assert not played.head.active
    assert q[-1, 0] == played.posture[pan] == pytest.approx(-0.2)
    assert np.abs(np.diff(q, axis=0)).max() <= (played.config.speed + 0.4) * DT + 1e-12
    jump = np.delete(np.abs(np.diff(v, axis=0)).max(axis=1), [4099, 4599])  # where the posture itself jumps
    assert jump.max() < 2.0 * played.config.speed * played.config.bandwidth * DT


def test_motions_start_below_the_head_or_where_they_have_it(talos: RobotModel) -> None:
    played = Played(talos)
    played.head.command(0.6, 0.1)
    played.run(0.3)
    moved, velocity, acceleration = played.head.step(played.posture, played.zero, played.zero, DT)
    from tests.unit.controllers.test_upper_body import reference

    tracked = structs.replace(
        reference(talos, 0.0), posture=moved, posture_velocity=velocity, posture_acceleration=acceleration
    )
    posture, rate = played.head.without_head(tracked)
    np.testing.assert_array_equal(posture, played.posture)
    np.testing.assert_array_equal(rate, played.zero)
    turn = JointTrajectory(("head_2_joint",), np.array([0.0, 1.0]), np.array([[0.4], [0.0]]))
    start, _ = played.head.without_head(tracked, turn)
    assert start[played.head.joints].tolist() == [0.4, played.posture[played.head.joints[1]]]
    malformed = replace(turn, positions=np.zeros((2, 3)))
    np.testing.assert_array_equal(played.head.without_head(tracked, malformed)[0], played.posture)


def test_one_motion_after_another_takes_the_head_over_without_a_jump(talos: RobotModel) -> None:
    played = Played(talos)
    pan = played.head.joints[0]
    from tests.unit.controllers.test_upper_body import reference

    tracked = reference(talos, 0.0)
    played.head.command(0.5, 0.1)
    played.run(3.0)
    for place in (0.0, 0.8, 0.1):  # setpoints, the next before the head is where the last one has it
        point = JointTrajectory(("head_2_joint",), np.array([0.1]), np.array([[place]]))
        played.posture, _ = played.head.without_head(structs.replace(tracked, posture=played.posture), point)
        assert played.posture[pan] == place
        played.head.release(point)
        played.run(0.02)
    played.run(4.0)
    assert not played.head.active and played.rows[-1][0, 0] == 0.1
    q, v, _ = np.moveaxis(played.series, 1, 0)
    assert np.abs(np.diff(q, axis=0)).max() <= played.config.speed * DT + 1e-12
    assert np.abs(np.diff(v, axis=0)).max() <= 2.0 * played.config.speed * played.config.bandwidth * DT + 1e-12


def test_a_motion_right_after_the_first_command_starts_from_the_posture_as_it_is(talos: RobotModel) -> None:
    from tests.unit.controllers.test_upper_body import reference

    head, tracked = Head(talos), reference(talos, 0.0)
    tracked.posture[head.joints] = 0.3, 0.1
    head.command(0.6, 0.2)  # and no tick since
    np.testing.assert_array_equal(head.without_head(tracked)[0], tracked.posture)


def test_what_is_no_angle_and_what_is_no_head_is_refused_by_name(talos: RobotModel, g1: RobotModel) -> None:
    with pytest.raises(CommandError, match="tilt: nan rad"):
        Head(talos).command(0.0, float("nan"))
    with pytest.raises(ConfigError, match="g1: head: the profile names no joints"):
        Head(g1)
    with pytest.raises(CommandError, match=r"no 'head\.pan' and 'head\.tilt'"):
        ControlStack(g1).look(0.0, 0.0)
    with pytest.raises(ValueError, match="same joint"):
        HeadJoints("head_1_joint", "head_1_joint")
    leg = RobotModel(replace(talos.profile, head=HeadJoints("torso_1_joint", "head_1_joint")))
    with pytest.raises(ConfigError, match="'torso_1_joint' moves a foot or the torso"):
        Head(leg)
