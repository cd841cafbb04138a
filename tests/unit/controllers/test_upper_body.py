"""Motions of arms and head in a walk: the legs are left alone, and nothing jumps."""

import numpy as np
import pytest

from controllers.balance.upper_body import UpperBodyMotion, free_joints
from models.errors import TrajectoryError
from models.robot_model import RobotModel
from models.types import JointTrajectory, Reference

DT, FADE = 0.001, 0.4


@pytest.mark.parametrize(("name", "count"), [("g1", 14), ("talos", 18)])
def test_arms_and_head_are_free_and_legs_and_waist_are_not(name: str, count: int) -> None:
    model = RobotModel.load(name)
    free = {joint for joint, is_free in zip(model.joint_names, free_joints(model), strict=True) if is_free}
    assert len(free) == count, sorted(free)
    assert not any(word in joint for joint in free for word in ("hip", "knee", "ankle", "leg", "waist", "torso"))


def reference(model: RobotModel, swing: float) -> Reference:
    """A walk's reference whose arms are swung so far [rad]."""
    posture, zero, _ = posture_of(model, swing)
    flat = np.zeros((2, 6))
    eye = np.eye(3)
    still = np.zeros(3)
    return Reference(still, still, still, eye, eye, posture, zero, zero, np.array([eye, eye]), flat[:, :3], flat, flat)


def posture_of(model: RobotModel, swing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A walk's posture whose arms are swung so far [rad], at rest."""
    zero = np.zeros(model.nj)
    return model.posture("stand") + np.where(free_joints(model), swing, 0.0), zero, zero


def motion(model: RobotModel) -> JointTrajectory:
    """Every joint to 0.3 rad off its place and back, within 2 s."""
    stand = model.posture("stand")
    away = np.clip(stand + 0.3, model.q_lower, model.q_upper)
    return JointTrajectory(model.joint_names, np.array([0.0, 1.0, 2.0]), np.array([stand, away, stand]))


def played(model: RobotModel, stop_at: float = np.inf, replaced_at: float = np.inf) -> np.ndarray:
    """Posture, velocity and acceleration of each tick (n, 3, nj), arms swung by 0.05 rad meanwhile."""
    upper, swung, rows = UpperBodyMotion(model, FADE), posture_of(model, 0.05), []
    upper.follow(motion(model), model.posture("stand"))
    while upper.active:
        if len(rows) * DT >= replaced_at:
            upper.follow(JointTrajectory(model.joint_names, np.array([1.0]), rows[-1][0][None]), rows[-1][0])
            replaced_at = np.inf
        if len(rows) * DT >= stop_at:
            upper.stop()
            stop_at = np.inf
        rows.append(upper.step(*swung, DT))
    assert all(after is before for after, before in zip(upper.step(*swung, DT), swung, strict=True))
    return np.array(rows)


def test_arms_follow_the_motion_and_legs_do_not(g1: RobotModel) -> None:
    free, rows = free_joints(g1), played(g1)
    assert len(rows) * DT == pytest.approx(2.0, abs=2 * DT)
    assert (rows[:, 0, ~free] == g1.posture("stand")[~free]).all()
    expected = np.clip(g1.posture("stand") + 0.3, g1.q_lower, g1.q_upper)
    assert rows[999, 0, free] == pytest.approx(expected[free], abs=1e-3)


@pytest.mark.parametrize(
    ("stop_at", "replaced_at"), [(np.inf, np.inf), (1.2, np.inf), (0.1, np.inf), (np.inf, 0.8), (0.5, 0.6), (1.7, 1.3)]
)
def test_nothing_jumps_and_the_rates_are_those_of_the_posture(
    g1: RobotModel, stop_at: float, replaced_at: float
) -> None:
    rows = played(g1, stop_at, replaced_at)
    ends = posture_of(g1, 0.05)[0]
    q = np.vstack([ends, rows[:, 0], ends])
    assert np.abs(np.diff(q, axis=0)).max() < 2.0 * DT  # slower than 2 rad/s throughout
    for order in (1, 2):
        rate = np.gradient(rows[:, order - 1], DT, axis=0)
        inner = np.ones(len(rows), dtype=bool)
        inner[[0, 1, -2, -1]] = False
        for change in filter(np.isfinite, (stop_at, replaced_at)):
            inner[abs(np.arange(len(rows)) - round(change / DT)) < 4] = False  # where it has to end, or is replaced
        turn = np.abs(rate - rows[:, order])[inner].max()
        assert turn < (0.01 if order == 1 else 0.2)
    if np.isfinite(stop_at) and not np.isfinite(replaced_at):
        assert len(rows) * DT < max(stop_at, FADE) + FADE + 0.01


def test_a_motion_from_elsewhere_is_refused(g1: RobotModel) -> None:
    upper = UpperBodyMotion(g1, FADE)
    with pytest.raises(TrajectoryError):
        upper.follow(motion(g1), g1.posture("stand") - 0.5)
    assert not upper.active
