"""A robot that walks towards a box stops before it, and walks on when it is gone."""

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from controllers.commands.obstacle_stop import BodyOutline
from models.types import Mode

FACE = 1.0
"""Where the near face of the box stands [m]; the robot starts at the origin."""


def _gap(loop: ClosedLoop) -> float:
    """True free way before the body, which heads along x [m]."""
    return float(FACE - loop.truth.q[0] - BodyOutline(loop.robot).reach(np.array([1.0, 0.0])))


@pytest.mark.long
def test_a_walk_ends_before_an_obstacle_and_goes_on_without() -> None:
    loop = ClosedLoop("g1", seed=2, terrain="box", obstacle_stop=True, record=False)
    guard = loop._guard
    assert guard is not None
    law = guard.law.config
    loop.plant.obstacle.place(FACE + 0.2, 0.0)
    loop.run(0.1)
    assert loop.command("forward").accepted  # 0.3 m/s
    loop.run(1.0)
    assert loop.truth.v[0] > 0.15
    loop.run(3.5)
    assert not loop.fallen and loop.mode is Mode.WALK
    assert not loop.gait.walking and "obstacle" in guard.reason
    assert law.stop_distance - 0.1 < _gap(loop) < law.latch_distance + 0.05

    steps = loop.gait.steps
    loop.set_velocity(0.3, 0.0, 0.0)  # commanding it again changes nothing
    loop.run(0.2)
    assert loop.gait.steps == steps and not loop.gait.walking
    loop.plant.obstacle.remove()
    loop.run(0.8 * law.release_time)
    assert guard.reason and not loop.gait.walking  # not free for long enough
    loop.run(1.5)
    assert not loop.fallen and not guard.reason
    assert loop.truth.v[0] > 0.15
    assert [text for _, text in loop.events if text.startswith("obstacle stop")][-1] == "obstacle stop: free"
