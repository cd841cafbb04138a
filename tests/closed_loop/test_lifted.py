"""A robot that is lifted while it steps freezes, and stands once it has been put down."""

import numpy as np
import pinocchio as pin
import pytest

from bridge.closed_loop import ClosedLoop
from models.constants import GRAVITY
from models.types import Mode
from planners.gait.state import GaitPhase


def hoist(loop: ClosedLoop, speed: float, duration: float) -> float:
    """Move the held robot up [m/s] for a time [s]; the fastest that any joint turned meanwhile [rad/s]."""
    fastest = 0.0
    for _ in range(round(duration / loop.plant.period)):
        loop.data.mocap_pos[0, 2] += speed * loop.plant.period
        loop.step()
        fastest = max(fastest, float(np.abs(loop.truth.v[6:]).max()))
    return fastest


def tilt_error(loop: ClosedLoop) -> float:
    """Angle between the estimated and the true vertical, in the base [rad]."""
    seen, true = (pin.Quaternion(state.q[3:7]).toRotationMatrix()[2] for state in (loop.state, loop.truth))
    return float(np.linalg.norm(np.cross(seen, true)))


@pytest.mark.long
@pytest.mark.parametrize(("robot", "seed"), [("g1", 3), ("talos", 3), ("talos", 4)])
def test_a_lifted_robot_freezes_and_stands_once_it_is_put_down(robot: str, seed: int) -> None:
    loop = ClosedLoop(robot, seed=seed, record=False)
    loop.command("walk")
    loop.set_velocity(0.0, 0.0, 0.3)
    loop.run(1.6)
    assert loop.gait.walking
    loop.plant.hold()
    hoist(loop, 0.3, 0.5)
    assert loop.gait.phase is GaitPhase.LIFTED
    steps = loop.gait.steps
    assert hoist(loop, 0.0, 1.5) < 4.0  # [rad/s] no kick (it was 36): the legs return slowly to the standing posture
    assert np.abs(loop.truth.q[7:] - loop.robot.posture("stand")).max() < 0.1
    loop.set_velocity(0.0, 0.0, 0.3)  # somebody goes on commanding
    hoist(loop, -0.2, 0.4)
    for _ in range(60):
        hoist(loop, -0.05, 0.05)
        if loop.plant.load > 0.95 * loop.robot.mass * GRAVITY:
            break
    assert tilt_error(loop) < 0.02  # [rad] as quiet as at rest, but moving: that it rests had turned it by 0.15
    loop.plant.release()
    loop.run(1.5)
    assert not loop.fallen and loop.mode is Mode.WALK
    assert loop.gait.phase is GaitPhase.STAND and loop.gait.steps == steps
    loop.set_velocity(0.0, 0.0, 0.3)
    loop.run(0.1)
    assert not loop.gait.walking  # that velocity is over: it has to be zero first
    loop.set_velocity(0.0, 0.0, 0.0)
    loop.set_velocity(0.0, 0.0, 0.3)
    loop.run(0.1)
    assert loop.gait.walking
