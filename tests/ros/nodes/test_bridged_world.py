"""Bridges that share a world, in this process and without their loop: who moves, who waits for whom."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger

from bridge.driver.world import DriverWorld
from bridge.launch.world import Inhabitant, WorldGraph, inhabitants
from bridge.nodes.robot_driver import RobotDriver
from bridge.plants.base import hanging_command
from bridge.plants.world import Place
from models.errors import PoiseError
from models.nodes.messages import JointCommandCodec
from models.robot_model import RobotModel
from models.types import JointCommand

pytestmark = pytest.mark.ros

MS = 1_000_000


class Clockless(DriverWorld):
    """A world that does not publish its time: it has no node of its own."""

    def _publish_time(self) -> None:
        pass


@pytest.fixture
def world(bench: Any) -> Iterator[DriverWorld]:
    """Two bridges, configured, the first active."""
    shared = Clockless()
    made = [_add(bench, shared, number, place=[0.0, 1.5 * number, 0.5 * number]) for number in range(2)]
    for node in made:
        node.trigger_configure()
    made[0].trigger_activate()
    yield shared


def _add(bench: Any, shared: DriverWorld, number: int, **parameters: object) -> Any:
    """A bridge of the world, not yet configured: that builds the world of those that are there."""
    return bench.add(partial(RobotDriver, shared, namespace=f"/robot_{number}"), configured=False, **parameters)


def _answer(bridge: RobotDriver, robot: RobotModel) -> None:
    carry = hanging_command(robot)
    command = JointCommand(carry.q, carry.v, carry.tau)
    bridge.commands.on_command(JointCommandCodec(robot).encode(bridge.tick * MS, command))


def test_a_bridge_that_is_not_active_is_a_statue_with_the_same_time(world: DriverWorld) -> None:
    first, second = world.drivers
    before = second.drivers.plant.truth.q
    assert world.running
    for _ in range(50):
        world.publish_tick(0.0)
        world.step()
    assert (first.tick, second.tick, world.tick) == (51, 51, 51)
    np.testing.assert_array_equal(second.drivers.plant.truth.q, before)
    second.trigger_activate()
    world.step()
    assert first.stamp == second.stamp == 52 * MS
    assert np.linalg.norm(second.drivers.plant.truth.q[:2] - [0.0, 1.5]) < 0.05


def test_a_pause_of_one_is_a_pause_of_all(world: DriverWorld) -> None:
    for bridge in world.drivers:
        bridge.trigger_activate()
        assert world.running
        bridge.paused = True
        assert not world.running
        for each in world.drivers:
            each.before_diagnostics()
            assert each.message == ("paused" if each.active else "configured")
        bridge.paused = False
    for bridge in world.drivers:
        bridge.trigger_deactivate()
    assert not world.running


def test_a_reset_is_refused_while_another_robot_holds_the_pause(world: DriverWorld) -> None:
    first, second = world.drivers
    second.trigger_activate()
    reset = next(each for each in first.services if each.srv_name.endswith("reset"))
    for bridge, refused in ((second, True), (first, False)):  # it ends its own pause
        bridge.paused = True
        first.drivers.plant.hoist(0.1)
        height = first.drivers.plant.truth.q[2]
        answer = reset.callback(Trigger.Request(), Trigger.Response())
        assert answer.success is not refused and ("'robot_1' has paused" in answer.message) is refused
        assert bool(first.drivers.plant.truth.q[2] == height) is refused
        bridge.paused = False


def test_lockstep_waits_for_all_that_take_commands_and_for_no_others(world: DriverWorld, g1: RobotModel) -> None:
    first, second = world.drivers
    second.trigger_activate()
    assert not world.answered and not world.free_running  # held, without a mode: time stands still
    first.commands.on_mode(String(data="stand"))
    assert not world.answered
    world.publish_tick(0.0)
    _answer(first, g1)
    assert world.answered  # the other one has no mode
    second.commands.on_mode(String(data="stand"))
    assert not world.answered
    _answer(second, g1)
    assert world.answered
    world.step()
    assert not world.answered
    for bridge in world.drivers:
        bridge.drivers.plant.release()
        bridge.commands.on_mode(String(data="damp"))
    assert world.free_running  # they fall, and time goes on


def test_bridges_that_want_different_worlds_are_refused(bench: Any) -> None:
    shared = Clockless()
    for number, terrain in enumerate(("flat", "tiles")):
        _add(bench, shared, number, terrain=terrain)
    shared.drivers[0].trigger_configure()
    assert "terrain: must be equal for all robots of a world" in shared.drivers[0].message
    with pytest.raises(PoiseError, match="terrain: must be equal for all robots of a world"):
        _ = shared.world


def test_a_place_needs_a_world_of_several(bench: Any) -> None:
    node = bench.add(RobotDriver, active=False, place="[1.0, 0.0, 0.0]")
    assert "place: only robots of a world" in node.message


def test_robots_are_read_from_the_command_line() -> None:
    found = inhabitants("robot_1=g1,robot_2=talos", ["robot_2=1,-1.5,0.5"], None)
    assert found["robot_1"] == Inhabitant("g1", None, {})
    assert found["robot_2"] == Inhabitant("talos", Place(1.0, -1.5, 0.5), {})
    assert not inhabitants("", [], None)


@pytest.mark.parametrize(
    ("robots", "places", "culprit"),
    [
        ("robot_1", [], "'robot_1' is not NAMESPACE=ROBOT"),
        ("robot_1=", [], "'robot_1=' is not NAMESPACE=ROBOT"),
        ("a=g1,a=talos", [], "'a' is given twice"),
        ("2=g1", [], "namespace '2'"),
        ("a=g1", ["b=0,0,0"], "no robot 'b' among --robots: a"),
        ("", ["b=0,0,0"], "no robot 'b' among --robots: none"),
        ("a=g1", ["a=0,0"], "'a=0,0' is not NAMESPACE=X,Y,HEADING"),
        ("a=g1", ["a=0,0,nan"], "place"),
    ],
)
def test_robots_that_cannot_be_read_are_quoted(robots: str, places: list[str], culprit: str) -> None:
    with pytest.raises(PoiseError, match=culprit):
        inhabitants(robots, places, None)


def test_a_world_has_robots_and_one_ground() -> None:
    with pytest.raises(PoiseError, match="no robot"):
        WorldGraph({})
    with pytest.raises(PoiseError, match="terrain: must be equal for all robots of a world"):
        WorldGraph({"a": Inhabitant("g1", parameters={"robot_driver": {"terrain": "tiles"}})})
