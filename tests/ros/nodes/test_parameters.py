"""Every parameter of every node is described, has a range where it is a number, and says whether it may change."""

import re
from collections.abc import Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rclpy.parameter import Parameter

from bridge.launch.layout import process_specs
from bridge.launch.parameters import node_parameters
from controllers.balance.tuning import TUNABLE
from controllers.stack import ControlStack
from models.nodes.base import PoiseNode
from models.nodes.spin import refuse_undeclared
from tests.reference import NODES, make_node, parameters

pytestmark = pytest.mark.ros

LIVE = {
    "balance_controller": {*TUNABLE, "force_deactivate"},
    "gait_planner": {"around"},
    "robot_driver": {"push.force", "push.duration", "push.body", "obstacle.place", "faults.scenario"},
}
"""Parameters that may be changed while a node runs; every other one is read-only."""

FREE = {"realtime.cores"}
"""Numbers that have no bounds of their own."""


@pytest.fixture(params=NODES)
def node(bench: Any, request: pytest.FixtureRequest) -> Iterator[PoiseNode]:
    """A node as it is before it is configured, and once it is."""
    made = bench.add(partial(make_node, request.param), active=False, diagnostics_period=10.0)
    assert made.get_name() == request.param
    assert made.message == "configured", made.message
    yield made


def _ranged(descriptor: ParameterDescriptor) -> bool:
    return bool(descriptor.floating_point_range or descriptor.integer_range)


def test_every_parameter_is_described(node: PoiseNode) -> None:
    found = parameters(node)
    assert len(found) > 5
    numbers = (ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_INTEGER)
    undescribed = [name for name, each in found.items() if len(re.sub(r"\[.*?\]", "", each.description)) < 8]
    assert not undescribed
    unbounded = [n for n, each in found.items() if each.type in numbers and not _ranged(each) and n not in FREE]
    assert not unbounded
    live = {name for name, each in found.items() if not each.read_only}
    assert live == LIVE.get(node.get_name(), set())


def test_what_is_read_only_cannot_be_changed(node: PoiseNode) -> None:
    (result,) = node.set_parameters([Parameter("robot", value="talos")])
    assert not result.successful and "read-only" in result.reason


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("processes", ["shared", "separate"])
@pytest.mark.parametrize("driver", [{}, {"real_time": "strict"}, {"plant": "unitree", "sensor_rate": 500.0}])
def test_what_the_launcher_sets_is_declared(
    bench: Any, driver: dict[str, object], processes: Any, lockstep: bool, tmp_path: Path
) -> None:
    specs = process_specs(processes, actions=True, camera=True, terrain_map=True)
    extra = {"robot_driver": driver, "gait_planner": {"around": True, "swing.edge": 0.02}}
    for name, given in node_parameters(specs, "g1", lockstep, tmp_path, extra).items():
        merged = name == "balance_controller" and processes == "shared"
        make = partial(NODES[name], *([ControlStack()] if merged else []))
        refuse_undeclared([bench.add(make, configured=False, **given)])


@pytest.mark.parametrize(
    ("driver", "budget"),
    [({}, None), ({"speed": 1.0}, None), ({"speed": 0.5}, 0.002), ({"speed": 0.25, "sensor_rate": 500.0}, 0.008)],
    ids=str,
)
def test_a_slower_simulation_leaves_a_tick_more_real_time(
    tmp_path: Path, driver: dict[str, object], budget: float | None
) -> None:
    given = node_parameters(process_specs(), "g1", False, tmp_path, {"robot_driver": {**driver, "real_time": "strict"}})
    assert given["balance_controller"].get("time_budget") == budget
    own = {"robot_driver": driver, "balance_controller": {"time_budget": 0.1}}
    assert node_parameters(process_specs(), "g1", False, tmp_path, own)["balance_controller"]["time_budget"] == 0.1


def test_no_node_is_left_out(root: Path) -> None:
    """Whatever derives from ``PoiseNode`` in a package is in the list that the other tests and the reference go by."""
    packages = ("models", "planners", "controllers", "bridge")
    for package in packages:
        for file in (root / package).rglob("nodes/*.py"):
            import_module(".".join(file.relative_to(root).with_suffix("").parts))
    found = {each for each in PoiseNode.__subclasses__() if each.__module__.split(".")[0] in packages}
    assert found == set(NODES.values())
