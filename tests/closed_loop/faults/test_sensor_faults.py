"""Pushes felt, and foot sensors that fail while the robot stands and walks: noise and delay as in the profile."""

import numpy as np
import pytest

from bridge.closed_loop import ClosedLoop
from bridge.plants.fault_plan import START, Fault, FaultPlan
from controllers.estimation.feet import FootSensorState
from models.constants import GRAVITY
from models.robot_model import RobotModel
from models.types import Mode


def loop_with(robot: RobotModel, *faults: Fault, seed: int = 3) -> ClosedLoop:
    return ClosedLoop(robot, seed=seed, record=False, faults=FaultPlan(faults, since=START))


def stuck(foot: str, wrench: float | list[float], **times: float) -> Fault:
    return Fault(f"foot:{foot}", "stuck", value=wrench, **times)


def half_weight(robot: RobotModel) -> tuple[float, ...]:
    return 0.0, 0.0, 0.5 * robot.mass * GRAVITY, 0.0, 0.0, 0.0


def active_for(loop: ClosedLoop, duration: float) -> float:
    """Share of the time in which a push is reported."""
    count = round(duration / loop.plant.period)
    seen = 0
    for _ in range(count):
        loop.step()
        seen += loop.estimator.push.active
    return seen / count


@pytest.mark.long
def test_known_pushes_are_felt_and_nothing_else(robot: RobotModel) -> None:
    loop = ClosedLoop(robot, seed=3, record=False)
    assert active_for(loop, 2.0) == 0.0
    weight = robot.mass * GRAVITY
    for direction, body in (
        ((0.15, 0.0, 0.0), "base_link"),
        ((0.0, 0.12, 0.05), "torso"),
        ((-0.12, 0.0, 0.0), "torso"),
    ):
        force = weight * np.array(direction)
        loop.apply_push(force, duration=0.15, body=body)
        loop.run(0.12)
        felt = []
        for _ in range(30):
            loop.step()
            felt.append(loop.estimator.push.force)
        assert loop.estimator.push.active
        assert np.mean(felt, axis=0) == pytest.approx(force, abs=0.1 * np.linalg.norm(force))
        loop.run(0.03)
        assert loop.estimator.push.impulse == pytest.approx(0.15 * force, abs=0.2 * 0.15 * np.linalg.norm(force))
        loop.run(0.77)
        assert not loop.estimator.push.active
    assert loop.command("squat").accepted
    assert active_for(loop, 1.5) == 0.0
    assert not loop.fallen


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("g1", "on"),
        ("g1", "off"),
        ("g1", "absent"),
        pytest.param("talos", "on", marks=pytest.mark.slow),
        pytest.param("talos", "off", marks=pytest.mark.long),
        pytest.param("talos", "absent", marks=pytest.mark.slow),
    ],
)
def test_stands_squats_and_is_pushed_without_a_foot_sensor(name: str, kind: str) -> None:
    robot = RobotModel.load(name)
    wrench = {"on": half_weight(robot), "off": 0.0, "absent": np.nan}[kind]
    feet = ("left", "right") if kind == "absent" else ("left",)
    loop = loop_with(robot, *(stuck(foot, wrench) for foot in feet))
    assert loop.command("squat").accepted
    loop.run(1.2)
    loop.apply_push((0.15 * robot.mass / 0.1, 0.1 * robot.mass / 0.1, 0.0), duration=0.1)
    loop.run(1.2)
    assert not loop.fallen and loop.mode is not Mode.DAMP
    assert all(contact.active for contact in loop.state.contacts)
    wrenches = np.array([contact.wrench for contact in loop.state.contacts])
    health = loop.estimator.health
    if kind == "on":  # in double support it is about right, so it may go unnoticed
        assert health.foot_sensors[1] is FootSensorState.SOUND
        return
    expected = FootSensorState.CONTRADICTED if kind == "off" else FootSensorState.ABSENT
    assert health.foot_sensors[0] is expected
    assert wrenches[:, 2] == pytest.approx(loop.plant.wrenches[:, 2], abs=0.06 * robot.mass * GRAVITY)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["on", "off", "absent"])
def test_walks_on_when_a_foot_sensor_fails(g1: RobotModel, kind: str) -> None:
    wrench = {"on": half_weight(g1), "off": 0.0, "absent": np.nan}[kind]
    loop = loop_with(g1, stuck("left", wrench, start=2.5))
    loop.command("walk")
    loop.set_velocity(0.3, 0.0, 0.0)
    start = loop.truth.q[0]
    assert active_for(loop, 4.0) == 0.0
    assert not loop.fallen and loop.mode is Mode.WALK
    assert loop.gait.steps >= 6
    assert loop.truth.q[0] - start > 0.6
    health = loop.estimator.health
    expected = FootSensorState.ABSENT if kind == "absent" else FootSensorState.CONTRADICTED
    assert health.foot_sensors == (expected, FootSensorState.SOUND)
    assert health.sensor_faults == (1, 0)


def test_a_sensor_that_speaks_again_is_taken_back(g1: RobotModel) -> None:
    loop = loop_with(g1, stuck("right", 0.0, start=1.5, end=1.8))
    loop.run(0.6)
    assert loop.estimator.health.foot_sensors == (FootSensorState.SOUND, FootSensorState.CONTRADICTED)
    loop.run(1.0)
    assert loop.estimator.health.foot_sensors == (FootSensorState.SOUND, FootSensorState.SOUND)
    assert loop.estimator.health.sensor_faults == (0, 1)
