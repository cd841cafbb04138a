"""Several robots in one MuJoCo model: each as it is alone, apart at first, touching where they meet."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from bridge.plants.mujoco import MujocoPlant, step_world
from bridge.plants.scanner import LaserScanner
from bridge.plants.world import SPACING, MujocoWorld, Place
from bridge.shared_world import SharedWorld
from models.errors import CommandError, ConfigError
from models.heading import heading
from models.mujoco_model import build_mujoco, build_mujoco_world, mujoco_to_pin, pin_to_mujoco
from models.robot_model import RobotModel
from models.types import JointCommand
from tests.mujoco_states import random_state


@pytest.fixture(scope="module")
def pair(g1: RobotModel, talos: RobotModel) -> MujocoWorld:
    return MujocoWorld({"a": g1, "b": talos}, {"b": Place(1.0, 2.0, 0.5)})


def _plants(world: MujocoWorld, **options: object) -> list[MujocoPlant]:
    models = [world.robot(name)[0] for name in world.robots]
    made = zip(models, world.robots, strict=True)
    return [MujocoPlant(model, world=world, name=name, **options) for model, name in made]  # type: ignore[arg-type]


def test_each_robot_has_the_dynamics_that_it_has_alone(g1: RobotModel, talos: RobotModel) -> None:
    """Mass matrix, bias forces and sites of a robot in the air are those of its own model, whoever else is there."""
    robots = {"a": g1, "b": talos}
    world = build_mujoco_world(robots)
    together = mujoco.MjData(world["a"].model)
    states = {name: random_state(robot, 3) for name, robot in robots.items()}
    for name, (q, v) in states.items():
        mj = world[name]
        together.qpos[mj.qpos], together.qvel[mj.qvel] = pin_to_mujoco(robots[name], mj, q, v)
        back = mujoco_to_pin(robots[name], mj, together.qpos[mj.qpos], together.qvel[mj.qvel])
        np.testing.assert_allclose(back[0], q, atol=1e-12)
        np.testing.assert_allclose(back[1], v, atol=1e-12)
    mujoco.mj_forward(world["a"].model, together)
    full = np.zeros((world["a"].model.nv, world["a"].model.nv))
    mujoco.mj_fullM(world["a"].model, together, full)
    for name, (q, v) in states.items():
        mj, alone = world[name], build_mujoco(robots[name])
        data = mujoco.MjData(alone.model)
        data.qpos[:], data.qvel[:] = pin_to_mujoco(robots[name], alone, q, v)
        mujoco.mj_forward(alone.model, data)
        own = np.zeros((alone.model.nv, alone.model.nv))
        mujoco.mj_fullM(alone.model, data, own)
        np.testing.assert_allclose(full[mj.qvel, mj.qvel], own, atol=1e-9)
        np.testing.assert_allclose(together.qfrc_bias[mj.qvel], data.qfrc_bias, atol=1e-8)
        np.testing.assert_allclose(together.site_xpos[mj.imu_site], data.site_xpos[alone.imu_site], atol=1e-12)
        np.testing.assert_array_equal(mj.joint_qpos - mj.qpos.start, alone.joint_qpos)
        assert mj.bodies.keys() == {*alone.bodies} - {"world"}
    couplings = full[world["a"].qvel, world["b"].qvel]
    assert not couplings.any()


def test_they_begin_in_their_places_and_are_held_there(pair: MujocoWorld) -> None:
    first, second = _plants(pair)
    for _ in range(300):
        step_world(pair, (first, second))
    for plant, place in ((first, Place()), (second, Place(1.0, 2.0, 0.5))):
        soles = pair.data.site_xpos[list(plant.mujoco.sole_sites)].mean(axis=0)
        np.testing.assert_allclose(soles, [place.x, place.y, 0.0], atol=0.01)
        assert heading(*plant.truth.q[3:7]) == pytest.approx(place.heading, abs=0.01)
        assert plant.t == pytest.approx(0.3)
        second.write(JointCommand.torque(np.zeros(second.robot.nj)))


def test_robots_that_are_not_placed_stand_side_by_side(g1: RobotModel) -> None:
    world = MujocoWorld({"a": g1, "b": g1, "c": g1})
    for number, plant in enumerate(_plants(world)):
        assert plant.truth.q[1] == pytest.approx(SPACING * number, abs=0.01)


def test_one_moves_while_the_other_stands_still(pair: MujocoWorld) -> None:
    first, second = _plants(pair)
    second.release()
    before = second.truth
    for _ in range(200):
        first.step()
    assert (first.t, second.t) == (pytest.approx(0.2), 0.0)
    np.testing.assert_array_equal(second.truth.q, before.q)
    np.testing.assert_array_equal(second.truth.v, before.v)
    for _ in range(200):
        step_world(pair, (first, second))
    assert second.truth.q[2] < before.q[2] - 0.005  # let go without torque: it sinks, but no faster for the wait
    sunk = second.truth.q[2]
    second.reset()
    assert second.truth.q[2] == pytest.approx(before.q[2]) and sunk < before.q[2]
    assert first.t == pytest.approx(0.4)


def test_torques_pushes_and_noise_are_of_one_robot(g1: RobotModel) -> None:
    world = MujocoWorld({"a": g1, "b": g1})
    first, second = _plants(world, seed=4)
    second.release()
    first.release()
    second.write(JointCommand.torque(np.full(g1.nj, 0.5)))
    first.close()
    assert world.data.ctrl[second.mujoco.actuator].all() and not world.data.ctrl[first.mujoco.actuator].any()
    first.push((0.0, 40.0, 0.0), 0.05)
    step_world(world, (first, second))
    assert world.data.xfrc_applied[first.mujoco.base_body, 1] == 40.0
    assert not world.data.xfrc_applied[second.mujoco.own_bodies].any()
    np.testing.assert_array_equal(first.noise.bias, second.noise.bias)  # of the seed, and both have the same
    other = MujocoPlant(g1, seed=5, world=world, name="b")
    assert (other.noise.bias != first.noise.bias).any()


def test_robots_push_each_other(g1: RobotModel) -> None:
    """One is shoved sideways in the air into the other: they meet, and what one loses in momentum the other gains."""
    world = MujocoWorld({"a": g1, "b": g1}, {"b": Place(y=0.8)}, terrain="flat")
    first, second = _plants(world)
    for plant in (first, second):
        plant.hoist(1.0)
        plant.release()
    world.data.qvel[first.mujoco.qvel.start + 1] = 2.0  # [m/s] to the left
    met = False
    for _ in range(250):
        step_world(world, (first, second))
        met |= bool(world.touching("a"))
    assert met and world.touching("a") in ("", "b")
    mujoco.mj_subtreeVel(world.model, world.data)
    speeds = world.data.subtree_linvel[[plant.mujoco.base_body for plant in (first, second)], 1]
    assert speeds[1] > 0.1
    assert speeds.sum() == pytest.approx(2.0, abs=0.02)


def test_a_place_that_is_taken_is_refused(g1: RobotModel) -> None:
    with pytest.raises(ConfigError, match="the place of b is occupied by a: place them farther apart"):
        MujocoWorld({"a": g1, "b": g1}, {"b": Place(y=0.2)})
    world = MujocoWorld({"a": g1, "b": g1})
    first, second = _plants(world)
    world.data.qpos[second.mujoco.qpos][:3] += [0.1, -SPACING, 0.0]
    mujoco.mj_forward(world.model, world.data)
    world.data.qpos[first.mujoco.qpos.start] += 3.0
    before = first.truth.q.copy()
    with pytest.raises(CommandError, match="the place of a is occupied by b"):
        first.reset()
    np.testing.assert_array_equal(first.truth.q, before)


@pytest.mark.parametrize(
    ("places", "name", "message"),
    [({"c": Place()}, "a", "unknown robot 'c'; known: a"), ({}, "d", "unknown robot 'd'; known: a")],
)
def test_unknown_robots_are_named(g1: RobotModel, places: dict[str, Place], name: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        MujocoPlant(g1, world=MujocoWorld({"a": g1}, places), name=name)


@pytest.mark.parametrize("option", ["calibration", "controller", "mcap"])
def test_what_is_of_one_robot_is_refused_for_several(option: str) -> None:
    with pytest.raises(ConfigError, match=f"{option}: for a single robot"):
        SharedWorld({"a": "g1", "b": "g1"}, **{option: Path("run.mcap")})


def test_a_robot_is_the_one_that_the_world_has(g1: RobotModel, talos: RobotModel) -> None:
    with pytest.raises(ConfigError, match="'a' has a model of g1, not the given model of talos"):
        MujocoPlant(talos, world=MujocoWorld({"a": g1}), name="a")
    with pytest.raises(ConfigError, match="robots: 0"):
        build_mujoco_world({})
    with pytest.raises(ConfigError, match="place"):
        Place(x=float("nan"))


def test_the_scanner_sees_the_other_robot_and_not_its_own(g1: RobotModel) -> None:
    world = MujocoWorld({"a": g1, "b": g1}, {"b": Place(2.0, 0.0, np.pi)})
    first, second = _plants(world)
    groups = world.model.geom_group.copy()
    for plant in (first, second):  # they look at each other
        scan = LaserScanner(plant, noise=0.0).scan(0.0)
        seen = np.isfinite(scan.ranges)
        angles = scan.angle_min + scan.angle_increment * np.flatnonzero(seen)
        assert 5 < seen.sum() < 60
        assert np.abs(angles).max() < 0.25  # ahead, as wide as a robot
        assert 1.6 < scan.ranges[seen].min() < 2.0
    np.testing.assert_array_equal(world.model.geom_group, groups)
    alone = LaserScanner(MujocoPlant(g1), noise=0.0).scan(0.0)
    assert not np.isfinite(alone.ranges).any()
