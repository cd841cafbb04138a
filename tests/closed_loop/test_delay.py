"""Delay between a sample and its command."""

import pytest

from bridge.closed_loop import ClosedLoop
from models.types import Mode


@pytest.mark.long
def test_the_robot_walks_with_a_delay_of_20_ms() -> None:
    """The drivers' torque lags behind the commands, which the joint monitor must not take for a broken motor."""
    loop = ClosedLoop(robot="g1", seed=21, delay_s=0.02, record=False)
    assert loop.command("walk").accepted
    loop.set_velocity(0.4, 0.0, 0.0)
    loop.run(6.0)
    assert loop.mode is Mode.WALK, loop.faults
    assert loop.truth.q[0] > 1.6
