"""Walking in the loop: estimator on, sensor noise on, 2 ms delay."""

from __future__ import annotations

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from models.errors import CommandError
from models.types import Mode, SolveStatus


def yaw(quaternion: np.ndarray) -> float:
    x, y, z, w = quaternion
    return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


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
    loop.run(8.0)
    assert loop.mode is Mode.WALK and not loop.fallen
    speed = (loop.truth.q[0] - start[0]) / (loop.t - t)
    assert speed == pytest.approx(0.3, rel=0.1)
    assert abs(loop.truth.q[1] - start[1]) < 0.15

    loop.set_velocity(0.0, 0.0, 0.5)
    before, turned = yaw(loop.truth.q[3:7]), 0.0
    for _ in range(40):
        loop.run(0.1)
        now = yaw(loop.truth.q[3:7])
        turned += (now - before + np.pi) % (2.0 * np.pi) - np.pi
        before = now
    assert not loop.fallen
    assert turned == pytest.approx(2.0, rel=0.2)

    steps = loop.gait.steps
    assert loop.command("stop").accepted
    loop.run(3.0)
    assert loop.mode is Mode.STAND and not loop.fallen
    assert loop.gait.steps - steps <= 2
    place = loop.truth.q[:2].copy()
    loop.run(5.0)
    assert np.linalg.norm(loop.truth.q[:2] - place) < 0.01
    assert np.abs(loop.truth.v[6:]).mean() < 0.02
    assert loop.foot_slip.max() < 0.02
    assert set(loop.log.statuses) == {SolveStatus.OPTIMAL}


@pytest.mark.parametrize("velocity", [(-0.25, 0.0, 0.0), (0.0, 0.2, 0.0), (0.5, 0.0, 0.0)])
def test_walks_backward_sideways_and_faster(velocity: tuple[float, float, float]) -> None:
    loop = ClosedLoop("g1", seed=5, record=False)
    loop.command("walk")
    loop.set_velocity(*velocity)
    loop.run(2.0)
    start, t = loop.truth.q[:2].copy(), loop.t
    loop.run(5.0)
    assert not loop.fallen
    moved = (loop.truth.q[:2] - start) / (loop.t - t)
    assert moved == pytest.approx(velocity[:2], abs=0.06)


def test_a_walk_repeats_bit_for_bit() -> None:
    def run() -> np.ndarray:
        loop.command("forward")
        loop.run(2.0)
        return loop.truth.q.copy()

    loop = ClosedLoop("g1", seed=6, record=False)
    first = run()
    loop.reset()
    assert (run() == first).all()
