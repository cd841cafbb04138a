"""The laws at lower rates than the one they are tuned for: what docs/latency.md says of them."""

import pytest

from bridge.closed_loop import ClosedLoop


@pytest.mark.slow
@pytest.mark.parametrize(("tick", "period"), [(0.001, 0.002), (0.001, 0.005), (0.002, 0.002)])
@pytest.mark.parametrize("robot", ["g1", "talos"])
def test_the_robot_stands_waves_and_walks_at_a_lower_rate(robot: str, tick: float, period: float) -> None:
    """Of the laws alone, or of the whole loop with its drivers; the drives have that of the physics."""
    loop = ClosedLoop(robot, timestep=tick, control_period_s=period, record=False)
    assert loop.plant.period == tick and loop.model.opt.timestep == 0.001
    loop.run(1.0)
    assert loop.command("wave").accepted
    assert loop.wait_motion()
    assert loop.command("walk").accepted
    loop.set_velocity(0.3, 0.0, 0.0)
    start = float(loop.truth.q[0])
    loop.run(4.0)
    assert not loop.fallen and loop.truth.q[0] - start > 0.6  # [m]
