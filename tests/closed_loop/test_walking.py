"""Walking in the loop: estimator on, sensor noise on, 2 ms delay."""

import math

import numpy as np
import pytest

from benchmarks.stability.push import PushMode
from benchmarks.stability.push_map import Trial, loop_of, prepare, survives
from bridge.closed_loop import ClosedLoop
from models.constants import GRAVITY
from models.errors import CommandError
from models.heading import heading
from models.types import Mode, SolveStatus
from planners.gait.state import GaitPhase


def test_walks_forward_turns_and_stops() -> None:
    loop = ClosedLoop("g1", seed=4)
    with pytest.raises(CommandError, match="command 'walk' first"):
        loop.set_velocity(0.3, 0.0, 0.0)
    assert loop.command("walk").accepted
    loop.run(0.5)
    assert loop.gait.steps == 0 and not loop.gait.walking  # no velocity, no step
    loop.set_velocity(0.3, 0.0, 0.0)
    loop.run(2.0)
    start, t = loop.truth.q[:3].copy(), loop.t
    loop.run(3.0)
    assert loop.mode is Mode.WALK and not loop.fallen
    speed = (loop.truth.q[0] - start[0]) / (loop.t - t)
    assert speed == pytest.approx(0.3, rel=0.05)
    assert abs(loop.truth.q[1] - start[1]) < 0.15

    loop.set_velocity(0.0, 0.0, 0.5)
    before, turned = heading(*loop.truth.q[3:7]), 0.0
    for _ in range(20):
        loop.run(0.1)
        now = heading(*loop.truth.q[3:7])
        turned += (now - before + np.pi) % (2.0 * np.pi) - np.pi
        before = now
    assert not loop.fallen
    assert turned == pytest.approx(1.0, rel=0.25)

    steps = loop.gait.steps
    assert loop.command("stop").accepted
    loop.run(3.0)
    assert loop.mode is Mode.STAND and not loop.fallen
    assert loop.gait.steps - steps <= 2
    place = loop.truth.q[:2].copy()
    loop.run(2.0)
    assert np.linalg.norm(loop.truth.q[:2] - place) < 0.01
    assert np.abs(loop.truth.v[6:]).mean() < 0.02
    assert loop.foot_slip.max() < 0.02
    assert set(loop.log.statuses) == {SolveStatus.OPTIMAL}


@pytest.mark.parametrize(
    ("robot", "velocity"),
    [
        ("g1", (-0.25, 0.0, 0.0)),
        pytest.param("g1", (0.0, 0.2, 0.0), marks=pytest.mark.long),
        ("g1", (0.7, 0.0, 0.0)),
        pytest.param("talos", (0.3, 0.0, 0.0), marks=pytest.mark.long),
    ],
)
def test_walks_backward_sideways_and_faster(robot: str, velocity: tuple[float, float, float]) -> None:
    loop = ClosedLoop(robot, seed=5, record=False)
    loop.command("walk")
    loop.set_velocity(*velocity)
    loop.run(1.5)
    start, t = loop.truth.q[:2].copy(), loop.t
    loop.run(2.0)
    assert not loop.fallen
    moved = (loop.truth.q[:2] - start) / (loop.t - t)
    assert moved == pytest.approx(velocity[:2], abs=0.08)


@pytest.mark.parametrize("direction", [(1.0, 0.0), pytest.param((-1.0, 0.0), marks=pytest.mark.long)])
def test_a_push_beyond_the_ankles_is_caught_by_steps(direction: tuple[float, float]) -> None:
    loop = ClosedLoop("g1", seed=1, record=False)
    loop.command("walk")
    loop.run(0.3)
    force = loop.robot.mass * 0.6 / 0.1  # N: 0.6 m/s in 0.1 s
    loop.apply_push((force * direction[0], force * direction[1], 0.0), 0.1)
    loop.run(4.0)
    assert not loop.fallen
    assert 1 <= loop.gait.steps <= 6
    assert not loop.gait.walking  # back to a standstill
    assert np.abs(loop.truth.v[6:]).mean() < 0.05


@pytest.mark.parametrize(("degrees", "seed"), [(70.0, 31), pytest.param(290.0, 32, marks=pytest.mark.long)])
def test_a_wide_step_keeps_the_base_upright(degrees: float, seed: int) -> None:
    """The ankle of the stance foot comes to its limit half-way: the sole turns over its edge instead of the base.

    With the feet 0.7 m apart the CoM has sunk by 5 cm in 0.2 s, or the rear leg is too short to step.
    """
    loop = ClosedLoop("g1", seed=seed, record=False)
    loop.run(1.0)
    force = 1.2 * loop.robot.mass / 0.1  # [N] 1.2 m/s in 0.1 s
    angle = math.radians(degrees)
    loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), 0.1)
    end, tilt = loop.t + 4.0, 0.0
    landed = loop.t + 0.35
    while loop.t < end:
        loop.run(0.01)
        assert not loop.fallen, loop.fall_reason
        if loop.t < landed:
            tilt = max(tilt, 2.0 * math.asin(math.hypot(*loop.truth.q[3:5])))  # of the base [rad]
    assert tilt < 0.2
    assert not loop.gait.walking


@pytest.mark.long
def test_the_feet_bear_load_while_the_body_sinks_for_a_wide_step() -> None:
    """A CoM that falls as fast as it can leaves no force with which the stance foot could keep the body upright."""
    loop = ClosedLoop("g1", seed=34, record=False)
    loop.run(1.0)
    start, force = loop.t, 1.4 * loop.robot.mass / 0.1  # [N] 1.4 m/s in 0.1 s
    loop.apply_push((-math.sqrt(0.5) * force, math.sqrt(0.5) * force, 0.0), 0.1)  # backward to the left
    forces = []
    while not loop.gait.view.swinging or loop.gait.steps == 0:
        loop.step()
        if loop.gait.view.swinging:
            forces.append(loop.plant.wrenches[:, 2].sum())
        assert loop.t < start + 1.0
    assert np.mean(forces) > 0.2 * loop.robot.mass * GRAVITY
    loop.run(4.0)
    assert not loop.fallen, loop.fall_reason
    assert not loop.gait.walking


@pytest.mark.long
def test_a_push_while_the_weight_shifts_before_the_first_step_is_caught() -> None:
    loop = ClosedLoop("g1", seed=2, record=False)
    loop.command("walk")
    loop.run(0.5)
    loop.set_velocity(0.3, 0.0, 0.0)
    while loop.gait.phase is not GaitPhase.START:
        loop.step()
    loop.run(0.1)
    loop.apply_push((0.0, 0.8 * loop.robot.mass / 0.1, 0.0), 0.1)
    start = loop.t
    while loop.gait.phase is GaitPhase.START:
        loop.step()
    assert loop.t - start < 0.2  # the shift alone lasts longer
    loop.run(4.0)
    assert not loop.fallen, loop.fall_reason
    assert loop.mode is Mode.WALK and loop.gait.steps > 4


@pytest.mark.long
def test_a_walk_repeats_bit_for_bit() -> None:
    def run() -> np.ndarray:
        loop.command("forward")
        loop.run(2.0)
        return loop.truth.q.copy()

    loop = ClosedLoop("g1", seed=6, record=False)
    first = run()
    loop.set_velocity(1.0, 0.0, 0.0)  # at another pace
    loop.run(2.5)
    loop.reset()
    assert (run() == first).all()


@pytest.mark.long
def test_after_a_walk_it_is_settled_only_when_the_robot_is_at_rest() -> None:
    loop = ClosedLoop("g1", seed=0, record=False)
    loop.command("walk")
    loop.set_velocity(0.3, 0.0, 0.0)
    loop.run(2.5)
    loop.set_velocity(0.0, 0.0, 0.0)
    end, heights = loop.t + 4.0, []
    while not loop.gait.settled:
        assert loop.t < end
        loop.run(0.02)
        if not loop.gait.walking:
            heights.append(loop.truth.q[2])
    assert max(heights) - min(heights) < 0.01  # the blend to standing leaves the height where it is
    place = loop.truth.q[:3].copy()
    loop.run(1.0)
    assert np.linalg.norm(loop.truth.q[:3] - place) < 0.003


@pytest.mark.parametrize(
    ("degrees", "waving"),
    [(90.0, False), *(pytest.param(*each, marks=pytest.mark.long) for each in ((180.0, False), (0.0, True)))],
)
def test_pushed_in_mode_stand_it_steps_and_is_back_in_its_stance(degrees: float, waving: bool) -> None:
    loop = ClosedLoop("g1", seed=2, record=False)
    loop.run(0.3)
    if waving:
        assert loop.command("wave").accepted
        loop.run(1.0)
    force = loop.robot.mass * 0.6 / 0.1  # [N] 0.6 m/s in 0.1 s
    angle = math.radians(degrees)
    loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), 0.1)
    loop.run(5.0)
    assert not loop.fallen, loop.fall_reason
    assert loop.mode is Mode.STAND
    assert loop.gait.steps >= 1 and loop.gait.settled
    left, right = loop.gait.footholds
    assert right.relative(left.x, left.y) == pytest.approx(
        (0.0, loop.gait.config.reach.width), abs=loop.gait.config.astride
    )
    assert np.abs(loop.truth.v[6:]).mean() < 0.05


@pytest.mark.parametrize("degrees", [pytest.param(45.0, marks=pytest.mark.long), 180.0])
def test_a_standing_robot_steps_to_take_a_push_and_then_steps_back_to_its_stance(degrees: float) -> None:
    """More than twice what the ankles take; it comes to rest astride first, then beside its other foot."""
    loop = ClosedLoop(robot="g1", seed=0, record=False)
    loop.command("walk")
    loop.run(0.3)
    force = 0.7 * loop.robot.mass / 0.1  # [N] 0.7 m/s in 0.1 s
    angle = math.radians(degrees)
    loop.apply_push((force * math.cos(angle), force * math.sin(angle), 0.0), 0.1)
    loop.run(4.0)
    assert not loop.fallen, loop.fall_reason
    assert loop.gait.steps >= 2
    assert not loop.gait.walking
    left, right = loop.gait.footholds
    assert right.relative(left.x, left.y) == pytest.approx(
        (0.0, loop.gait.config.reach.width), abs=loop.gait.config.astride
    )


@pytest.mark.long
def test_the_foot_that_has_just_landed_steps_again_when_that_catches_a_push() -> None:
    """Pushed towards the left foot as it lands: the right one could only cross behind it or in front."""
    loop = ClosedLoop("g1", seed=24, record=False)
    loop.command("walk")
    loop.set_velocity(0.4, 0.0, 0.0)
    loop.run(2.5)
    while not (loop.gait.phase is GaitPhase.DOUBLE and loop.gait.stance == 0):
        loop.step()
    force = math.sqrt(0.5) * 1.1 * loop.robot.mass / 0.1  # [N] 1.1 m/s in 0.1 s
    loop.apply_push((force, force, 0.0), 0.1)
    while loop.gait.phase is not GaitPhase.SINGLE:
        loop.step()
    assert loop.gait.stance == 1
    loop.run(4.0)
    assert not loop.fallen, loop.fall_reason


@pytest.mark.long
def test_a_foot_that_has_just_lost_its_load_bears_again_when_the_other_one_catches_a_push() -> None:
    """Pushed to the left as the left foot lands, and the right one is still on the floor without a load."""
    loop, trial = loop_of("g1"), Trial(PushMode.WALK, 212, 0, 0.5 * math.pi)
    prepare(loop, trial)
    assert survives(loop, trial, 0.9).reason == ""


@pytest.mark.long
def test_only_an_urgent_step_reaches_beyond_the_edge_of_the_support() -> None:
    loop = ClosedLoop("g1", seed=3, record=False)
    loop.command("walk")
    loop.set_velocity(0.4, 0.0, 0.0)
    loop.run(1.5)
    shares = set()
    for _ in range(1000):
        loop.step()
        shares.add(loop.stack.reference.momentum)
    assert shares == {0.0}
    loop.apply_push((0.0, 0.8 * loop.robot.mass / 0.1, 0.0), 0.1)
    for _ in range(400):
        loop.step()
        shares.add(loop.stack.reference.momentum)
    assert 1.0 in shares
    loop.run(3.0)
    assert not loop.fallen, loop.fall_reason
