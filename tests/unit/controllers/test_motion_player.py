"""Motions that replace a running one: posture and velocity go on without a step."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from msgspec.structs import replace

from controllers.balance.motion_player import MotionPlayer
from controllers.whole_body.config import load_balance_config
from models.config import default_config
from models.errors import TrajectoryError
from models.robot_model import RobotModel
from models.types import JointTrajectory, Reference, Vector
from planners.motion_config import MotionConfig
from tests.unit.controllers.test_upper_body import reference

DT, SPEED = 0.001, 2.0
MOVED, OTHER = "left_elbow", "right_elbow"


class Played:
    """A player whose joint ``MOVED`` is in motion at ``SPEED`` [rad/s] until a second motion replaces the first."""

    def __init__(self, model: RobotModel) -> None:
        self.model, self.player = model, MotionPlayer(model, load_balance_config(model), None)
        self.joint = model.joint_index(MOVED)
        self.begin = model.posture("stand")
        self.last: tuple[Vector, Vector, Vector] = self.begin, self.player.zero, self.player.zero
        point = np.array([[self.begin[self.joint] + 0.3]])
        self.follow((MOVED,), [0.3], point, np.array([[SPEED]]))
        while self.last[1][self.joint] < 0.99 * SPEED:
            self.last = self.player.step(DT)

    @property
    def reference(self) -> Reference:
        return replace(reference(self.model, 0.0), posture=self.last[0], posture_velocity=self.last[1])

    def follow(self, names: tuple[str, ...], times: list[float], q: np.ndarray, v: np.ndarray | None = None) -> None:
        trajectory = JointTrajectory(names, np.array(times), q, v)
        self.player.follow(trajectory, self.reference, walking=False, stepping=False)

    def to_the_end(self) -> np.ndarray:
        """Posture, velocity and acceleration of the last tick before and of those until rest (n, 3, nj)."""
        rows = [self.last]
        while self.player.active:
            rows.append(self.player.step(DT))
        return np.array(rows)


@pytest.mark.parametrize(
    ("name", "times", "offsets", "velocities"),
    [
        (MOVED, [0.0, 1.0], [0.0, 0.2], None),
        (MOVED, [0.0, 0.01, 0.02, 0.03, 1.0], [0.0, 0.0, 0.0, 0.0, 0.0], None),  # as dense as a planner's
        (MOVED, [0.0], [0.09], [0.1]),
        (OTHER, [0.5], [0.3], None),  # another joint
        (OTHER, [0.0], [0.0], None),
    ],
)
def test_a_motion_that_replaces_another_takes_its_velocity_over(
    g1: RobotModel, name: str, times: list[float], offsets: list[float], velocities: list[float] | None
) -> None:
    played = Played(g1)
    here, index = played.last[0].copy(), g1.joint_index(name)
    points = (here[index] + np.array(offsets))[:, None]
    played.follow((name,), times, points, None if velocities is None else np.array(velocities)[:, None])
    rows = played.to_the_end()
    q, v, a = rows.transpose(1, 0, 2)
    assert np.abs(np.diff(q, axis=0)).max() < 1.1 * SPEED * DT  # no step
    assert np.abs(np.diff(v, axis=0)).max() < 80.0 * DT
    assert np.abs(np.diff(q, axis=0) / DT - 0.5 * (v[1:] + v[:-1])).max() < 1e-3
    assert np.abs(np.diff(v[1:], axis=0) / DT - 0.5 * (a[2:] + a[1:-1])).max() < 0.5
    if velocities is None:
        assert q[-1, index] == pytest.approx(points[-1, 0], abs=1e-9)
    others = np.arange(g1.nj) != index
    assert q[-1, others] == pytest.approx(here[others], abs=1e-9)
    assert not v[-1].any()


def streamed(model: RobotModel, setpoint: Callable[[float], float], due: float = 0.0, lost: int = 10**9) -> np.ndarray:
    """Position from the begin [rad], velocity and acceleration of a joint with a lone point every 20 ms (n, 3).

    Each ``lost``-th point does not arrive.
    """
    played = Played(model)
    played.player.reset(played.begin)
    played.last, rows = played.player.step(DT), []
    for tick in range(2000):
        if tick % 20 == 0 and (tick // 20 + 1) % lost:
            played.follow((MOVED,), [due], np.array([[played.begin[played.joint] + setpoint(tick * DT)]]))
        played.last = played.player.step(DT)
        rows.append([part[played.joint] for part in played.last])
    return np.array(rows) - [played.begin[played.joint], 0.0, 0.0]


@pytest.mark.parametrize("due", [0.0, 0.02])
@pytest.mark.parametrize("jitter", [0.0, 0.004])
def test_a_setpoint_far_away_is_reached_at_a_sane_speed(g1: RobotModel, due: float, jitter: float) -> None:
    q, v, a = streamed(g1, lambda t: jitter * math.sin(999.0 * t) - 1.0, due).T
    assert q[-1] == pytest.approx(-1.0, abs=0.005)
    assert np.abs(v).max() < 3.0 and np.abs(a).max() < 40.0
    played = Played(g1)
    played.player.reset(played.begin)
    played.last = played.player.step(DT)
    played.follow((MOVED,), [due], np.array([[played.begin[played.joint] - 1.0]]))
    assert (
        np.abs(played.to_the_end()[:, 2]).max()
        < 1.01 * default_config(MotionConfig, "planners", "motion").limits.acceleration
    )


@pytest.mark.parametrize("lost", [5, 10, 10**9])
def test_a_fast_stream_is_followed_without_delay_also_after_a_lost_point(g1: RobotModel, lost: int) -> None:
    def swing(t: float) -> float:
        return 0.5 * math.sin(2.0 * math.pi * t) * min(t, 1.0)

    lag = 0.065
    q = streamed(g1, swing, lost=lost)[:, 0]
    assert q[500:] == pytest.approx([swing(DT * tick - lag) for tick in range(500, 2000)], abs=0.02)


def test_a_setpoint_before_now_is_refused(g1: RobotModel) -> None:
    with pytest.raises(TrajectoryError, match="before the start"):
        Played(g1).follow((MOVED,), [-1.0], np.array([[0.5]]))


@pytest.mark.parametrize(("name", "room", "target"), [(OTHER, 0.01, 0.0), (MOVED, 0.05, 0.0), (MOVED, 0.2, -0.5)])
def test_what_fades_out_stays_within_the_limits(g1: RobotModel, name: str, room: float, target: float) -> None:
    played = Played(g1)
    limit = float(g1.q_upper[played.joint])
    played.last[0][played.joint] = limit - room
    played.follow((name,), [2.0], (played.last[0][g1.joint_index(name)] + target).reshape(1, 1))
    q, v, _ = played.to_the_end()[1:, :, played.joint].T
    assert q.max() <= limit + 1e-12
    assert not v[q >= limit - 1e-12].any()
    assert q[-1] == pytest.approx(limit - room + target, abs=1e-9)


@pytest.mark.parametrize("walks", [False, True])
def test_arms_that_return_from_a_motion_of_a_walk_go_on_from_where_they_are(g1: RobotModel, walks: bool) -> None:
    played, away = Played(g1), np.clip(g1.posture("stand") + 1.0, g1.q_lower, g1.q_upper)
    played.player.reset(played.begin)
    played.last = played.player.step(DT)
    motion = JointTrajectory(g1.joint_names, np.array([1.5, 3.0]), np.array([away, played.begin]))
    played.player.follow(motion, played.reference, walking=True, stepping=False)
    for _ in range(1500):
        played.last = played.player.step(DT)
    played.player.end_walk()
    for _ in range(200):
        played.last = played.player.step(DT)
    if walks:
        played.player.stand_up()
    else:
        played.follow(g1.joint_names, [1.0], played.begin[None])
    rows = np.array([played.last, *(played.player.step(DT) for _ in range(1000))])
    q, v, _ = rows.transpose(1, 0, 2)
    assert np.abs(np.diff(q, axis=0)).max() < 6.0 * DT
    assert np.abs(np.diff(v, axis=0)).max() < 80.0 * DT
