"""Standing balance in the loop: estimator on, sensor noise on, 2 ms delay."""

import math

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from models.constants import GRAVITY
from models.types import Mode

ROBOTS = ("g1", "talos")
SHARE_OF_BOUND = 0.9
DURATION = 0.1


def ankle_bound(loop: ClosedLoop, direction: np.ndarray) -> float:
    """``F = m w^2 d / (1 - exp(-w T))`` [N] with d from the CoM at rest to the edge of the soles' bounding hull."""
    soles = np.array([loop.data.site_xpos[site] for site in loop.plant.mujoco.sole_sites])
    corners = np.vstack([soles[i] + foot.corners for i, foot in enumerate(loop.robot.feet)])[:, :2]
    com = loop.result.com
    # Feet stand side by side and parallel: the hull is their bounding box.
    low, high = corners.min(axis=0), corners.max(axis=0)
    distances = [((high if u > 0 else low)[i] - com[i]) / u for i, u in enumerate(direction) if abs(u) > 1e-9]
    omega = math.sqrt(GRAVITY / com[2])
    return loop.robot.mass * omega**2 * min(distances) / (1.0 - math.exp(-omega * DURATION))


def without_steps(robot: str) -> ClosedLoop:
    """A robot that keeps its feet where they are."""
    loop = ClosedLoop(robot=robot, seed=1, record=False)
    assert isinstance(loop.controller, BalanceController)
    loop.controller.no_step = True
    return loop


@pytest.mark.parametrize("robot", ROBOTS)
def test_stands_still(robot: str) -> None:
    loop = ClosedLoop(robot=robot, seed=3)
    height = loop.truth.q[2]
    start = loop.result.com.copy()
    speeds = []
    for _ in range(300):
        loop.run(0.01)
        speeds.append(np.abs(loop.truth.v[6:]).mean())
    assert loop.mode is Mode.STAND and not loop.fallen
    assert np.mean(speeds) < 0.02
    assert np.linalg.norm((loop.result.com - start)[:2]) < 0.01
    assert abs(loop.truth.q[2] - height) < 0.005
    assert loop.foot_slip.max() < 0.005


@pytest.mark.parametrize("robot", ["g1", pytest.param("talos", marks=pytest.mark.long)])
def test_takes_the_required_pushes_without_a_step(robot: str) -> None:
    loop = without_steps(robot)
    loop.run(0.5)
    for angle in np.radians([0.0, 90.0, 180.0, 315.0]):
        direction = np.array([math.cos(angle), math.sin(angle)])
        force = SHARE_OF_BOUND * ankle_bound(loop, direction)
        loop.apply_push((*(force * direction), 0.0), DURATION, body="base_link")
        loop.run(2.0)
        assert loop.mode is Mode.STAND and not loop.fallen, (angle, loop.fall_reason)
        assert np.abs(loop.truth.v[:6]).max() < 0.05, angle
        assert loop.foot_slip.max() < 0.01, angle


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_push_twice_the_bound_knocks_it_over(robot: str) -> None:
    """The push test can fail: no controller without steps survives this."""
    loop = without_steps(robot)
    loop.run(0.2)
    force = 2.5 * ankle_bound(loop, np.array([1.0, 0.0]))
    loop.apply_push((force, 0.0, 0.0), DURATION, body="base_link")
    loop.run(2.0)
    assert loop.fallen


@pytest.mark.parametrize(
    ("robot", "motion"),
    [
        ("g1", "wave"),
        pytest.param("talos", "squat", marks=pytest.mark.long),
        pytest.param("g1", "squat", marks=pytest.mark.long),
        pytest.param("talos", "wave", marks=pytest.mark.long),
    ],
)
def test_moves_while_pushed(robot: str, motion: str) -> None:
    loop = ClosedLoop(robot=robot, seed=2, record=False)
    loop.run(0.2)
    force = 0.5 * SHARE_OF_BOUND * ankle_bound(loop, np.array([0.0, 1.0]))
    lowest = height = loop.truth.q[2]
    assert loop.command(motion).accepted
    loop.run(1.5)
    loop.apply_push((0.0, force, 0.0), DURATION, body="base_link")
    assert loop.mode is Mode.MOTION
    for _ in range(60):
        loop.run(0.1)
        lowest = min(lowest, loop.truth.q[2])
        if loop.mode is not Mode.MOTION:
            break
    assert loop.mode is Mode.STAND and not loop.fallen, loop.fall_reason
    loop.run(1.0)
    assert loop.mode is Mode.STAND and not loop.fallen, loop.fall_reason
    assert loop.foot_slip.max() < 0.01
    if motion == "squat":
        assert lowest < height - 0.05
    assert abs(loop.truth.q[2] - height) < 0.01


def test_push_to_the_left_mirrors_push_to_the_right() -> None:
    """With exact sensors the G1 is symmetric up to the small asymmetry of its URDF."""
    sway = []
    for side in (1.0, -1.0):
        loop = ClosedLoop(robot="g1", sensor_noise=False, record=False)
        start = loop.result.com.copy()
        loop.apply_push((0.0, 80.0 * side, 0.0), DURATION, body="base_link")
        loop.run(0.3)
        sway.append(side * (loop.result.com - start)[1])
    assert sway[0] > 0.005
    np.testing.assert_allclose(sway[0], sway[1], rtol=0.05)
