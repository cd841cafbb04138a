"""The check at the door of a joint trajectory, and the curve through its points."""

from dataclasses import replace

import numpy as np
import pytest

from models.errors import JointNameError, TrajectoryError
from models.robot_model import RobotModel
from models.trajectory import TrajectorySampler, thin, validate_trajectory
from models.types import JointTrajectory

KNEE = "left_knee_joint"
ELBOW = "right_elbow_joint"


def make(model: RobotModel, n: int = 4, step: float = 0.1) -> JointTrajectory:
    """A slow move of two joints from the standing posture."""
    start = model.posture("stand")[[model.joint_index(KNEE), model.joint_index(ELBOW)]]
    ramp = np.linspace(0.0, 1.0, n)[:, None]
    return JointTrajectory(
        joint_names=(KNEE, ELBOW),
        times=step * np.arange(n),
        positions=start + ramp * np.array([0.1, -0.05]),
        velocities=np.zeros((n, 2)),
        efforts=np.zeros((n, 2)),
    )


def check(traj: JointTrajectory, model: RobotModel) -> None:
    validate_trajectory(traj, model, start_q=model.posture("stand"))


def test_valid_trajectory_passes(g1: RobotModel) -> None:
    check(make(g1), g1)


def test_unknown_joint(g1: RobotModel) -> None:
    with pytest.raises(JointNameError, match="left_antenna"):
        check(replace(make(g1), joint_names=(KNEE, "left_antenna")), g1)


def test_duplicate_joint(g1: RobotModel) -> None:
    with pytest.raises(JointNameError, match=f"'{KNEE}' is given twice"):
        check(replace(make(g1), joint_names=(KNEE, KNEE)), g1)


def test_no_joints(g1: RobotModel) -> None:
    with pytest.raises(TrajectoryError, match="joint_names: empty"):
        check(replace(make(g1), joint_names=()), g1)


def test_empty(g1: RobotModel) -> None:
    nothing = JointTrajectory((KNEE,), np.zeros(0), np.zeros((0, 1)))
    with pytest.raises(TrajectoryError, match="no points"):
        check(nothing, g1)


def test_too_many_points(g1: RobotModel) -> None:
    with pytest.raises(TrajectoryError, match="10001 points, at most 10000"):
        check(make(g1, n=10001), g1)


@pytest.mark.parametrize("field", ["positions", "velocities", "efforts"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_not_finite(g1: RobotModel, field: str, bad: float) -> None:
    traj = make(g1)
    values = getattr(traj, field).copy()
    values[2, 1] = bad
    with pytest.raises(TrajectoryError, match=f"'{ELBOW}', point 2: {field} is {bad}"):
        check(replace(traj, **{field: values}), g1)


def test_time_not_finite(g1: RobotModel) -> None:
    with pytest.raises(TrajectoryError, match="times: point 1 is nan"):
        check(replace(make(g1), times=np.array([0.0, np.nan, 0.2, 0.3])), g1)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0, 0.1, 0.1, 0.2], "point 2 at 0.1 s is equal to point 1"),
        ([0.0, 0.2, 0.1, 0.3], "point 2 at 0.1 s is before point 1"),
        ([-0.1, 0.0, 0.1, 0.2], "point 0 is at -0.1 s"),
    ],
)
def test_bad_times(g1: RobotModel, times: list[float], message: str) -> None:
    with pytest.raises(TrajectoryError, match=message):
        check(replace(make(g1), times=np.array(times)), g1)


@pytest.mark.parametrize("field", ["positions", "velocities", "efforts"])
def test_wrong_shape(g1: RobotModel, field: str) -> None:
    with pytest.raises(TrajectoryError, match=rf"{field}: expected 4 points of 2 joints, found shape \(4, 3\)"):
        check(replace(make(g1), **{field: np.zeros((4, 3))}), g1)


def test_times_with_two_axes(g1: RobotModel) -> None:
    with pytest.raises(TrajectoryError, match="times: expected one axis"):
        check(replace(make(g1), times=np.zeros((4, 1))), g1)


def test_outside_position_limits(g1: RobotModel) -> None:
    traj = make(g1)
    traj.positions[3, 0] = g1.q_upper[g1.joint_index(KNEE)] + 0.01
    with pytest.raises(TrajectoryError, match=f"'{KNEE}', point 3: position .* outside"):
        check(traj, g1)


def test_given_velocity_beyond_limit(g1: RobotModel) -> None:
    traj = make(g1)
    traj.velocities[1, 1] = -1.5 * g1.v_max[g1.joint_index(ELBOW)]  # type: ignore[index]
    with pytest.raises(TrajectoryError, match=f"'{ELBOW}', point 1: velocity .* beyond the limit"):
        check(traj, g1)


def test_effort_beyond_limit(g1: RobotModel) -> None:
    traj = make(g1)
    traj.efforts[1, 1] = 1.5 * g1.tau_max[g1.joint_index(ELBOW)]  # type: ignore[index]
    with pytest.raises(TrajectoryError, match=f"'{ELBOW}', point 1: effort .* beyond the limit"):
        check(traj, g1)


def test_too_fast_between_points(g1: RobotModel) -> None:
    with pytest.raises(TrajectoryError, match=f"'{KNEE}', point 0: the curve after this point reaches .* rad/s"):
        check(replace(make(g1, step=0.002), velocities=None), g1)


def test_leaves_position_limits_between_points(g1: RobotModel) -> None:
    knee = g1.joint_index(KNEE)
    top = g1.q_upper[knee]
    start = g1.posture("stand").copy()
    start[knee] = top - 0.05
    swing = JointTrajectory((KNEE,), np.array([0.0, 0.2]), np.full((2, 1), top - 0.05), np.array([[3.0], [-3.0]]))
    with pytest.raises(TrajectoryError, match=f"'{KNEE}', point 0: the curve after this point leaves"):
        validate_trajectory(swing, g1, start_q=start)


def test_start_jump(g1: RobotModel) -> None:
    traj = make(g1)
    with pytest.raises(TrajectoryError, match=f"'{ELBOW}', point 0: start jump of -0.3 rad"):
        check(replace(traj, positions=traj.positions + np.array([0.0, -0.3])), g1)


def test_later_first_point_may_be_further_away(g1: RobotModel) -> None:
    traj = make(g1)
    check(replace(traj, positions=traj.positions + np.array([0.0, -0.3]), times=traj.times + 0.5), g1)


def test_moving_end_passes(g1: RobotModel) -> None:
    traj = make(g1)
    traj.velocities[-1, 0] = 0.2  # type: ignore[index]
    check(traj, g1)


def test_curve_meets_points_and_holds_the_rest(g1: RobotModel) -> None:
    traj, start = make(g1), g1.posture("stand")
    sampler = TrajectorySampler(traj, g1, start)
    columns = [g1.joint_index(KNEE), g1.joint_index(ELBOW)]
    others = np.setdiff1d(np.arange(g1.nj), columns)
    for t, point in zip(traj.times, traj.positions, strict=True):
        q, v, _ = sampler.sample(float(t))
        np.testing.assert_allclose(q[columns], point, atol=1e-12)
        np.testing.assert_allclose(v[columns], 0.0, atol=1e-12)
        np.testing.assert_array_equal(q[others], start[others])
    q, v, a = sampler.sample(sampler.duration + 1.0)
    np.testing.assert_array_equal(q[columns], traj.positions[-1])
    assert not v.any() and not a.any()


def test_velocity_and_acceleration_are_the_derivatives_and_continuous(g1: RobotModel) -> None:
    rng = np.random.default_rng(3)
    times = np.array([0.05, 0.3, 0.35, 1.2, 1.5])
    traj = JointTrajectory((KNEE, ELBOW), times, 0.5 + 0.1 * rng.standard_normal((5, 2)), rng.standard_normal((5, 2)))
    sampler = TrajectorySampler(traj, g1, g1.posture("stand"), rng.standard_normal(g1.nj))
    h = 1e-6
    for t in rng.uniform(2 * h, 1.5 - 2 * h, 200):
        q0, v0, _ = sampler.sample(t - h)
        _, v, a = sampler.sample(t)
        q1, v1, _ = sampler.sample(t + h)
        np.testing.assert_allclose(v, (q1 - q0) / (2 * h), atol=1e-5)
        np.testing.assert_allclose(a, (v1 - v0) / (2 * h), atol=1e-3)
    for t in times[:-1]:
        for before, after in zip(sampler.sample(t - 1e-9), sampler.sample(t + 1e-9), strict=True):
            np.testing.assert_allclose(before, after, atol=1e-3)


def test_without_velocities_no_joint_overshoots_its_points(g1: RobotModel) -> None:
    steps = np.array([0.5, 0.5, 0.9, 0.9, 0.6, 0.6])[:, None]
    traj = JointTrajectory((KNEE,), np.array([0.0, 0.2, 0.3, 1.0, 1.1, 2.0]), steps)
    start = g1.posture("stand").copy()
    start[g1.joint_index(KNEE)] = 0.5
    sampler = TrajectorySampler(traj, g1, start)
    knee = [sampler.sample(t)[0][g1.joint_index(KNEE)] for t in np.linspace(0.0, 2.0, 2001)]
    assert min(knee) >= 0.5 - 1e-12 and max(knee) <= 0.9 + 1e-12


def test_effort_is_linear_between_points(g1: RobotModel) -> None:
    traj = make(g1)
    traj.efforts[:, 0] = [0.0, 2.0, 4.0, 4.0]  # type: ignore[index]
    sampler = TrajectorySampler(traj, g1, g1.posture("stand"))
    assert sampler.effort(0.15)[g1.joint_index(KNEE)] == pytest.approx(3.0)
    assert sampler.effort(9.0)[g1.joint_index(KNEE)] == pytest.approx(4.0)


def test_joint_order_does_not_matter(g1: RobotModel) -> None:
    traj = make(g1)
    assert traj.velocities is not None and traj.efforts is not None
    swapped = JointTrajectory(
        (ELBOW, KNEE), traj.times, traj.positions[:, ::-1], traj.velocities[:, ::-1], traj.efforts[:, ::-1]
    )
    one, other = (TrajectorySampler(x, g1, g1.posture("stand")) for x in (traj, swapped))
    for t in np.linspace(0.0, 0.4, 21):
        np.testing.assert_array_equal(np.array(one.sample(t)), np.array(other.sample(t)))


@pytest.mark.parametrize(("count", "most"), [(5, 5), (6, 5), (1821, 600), (100, 2), (601, 600)])
def test_a_thinned_trajectory_keeps_its_ends_and_what_belongs_together(count: int, most: int) -> None:
    times = np.arange(count) * 0.01
    whole = JointTrajectory(("a",), times, times[:, None], 2.0 * times[:, None], 3.0 * times[:, None])
    thinned = thin(whole, most)
    assert 2 <= len(thinned.times) <= most
    assert (thinned.times[0], thinned.times[-1]) == (times[0], times[-1])
    assert (np.diff(thinned.times) > 0.0).all()
    for column, factor in ((thinned.positions, 1.0), (thinned.velocities, 2.0), (thinned.efforts, 3.0)):
        np.testing.assert_array_equal(column[:, 0], factor * thinned.times)
    assert thin(JointTrajectory(("a",), times, times[:, None]), most).velocities is None
