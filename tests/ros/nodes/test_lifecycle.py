"""Every node goes through its states again and again, and leaves nothing behind when it fails."""

from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import IntegerRange
from rclpy.lifecycle import TransitionCallbackReturn
from std_msgs.msg import String

from bridge.nodes.robot_driver import RobotDriver
from bridge.ros.lifecycle import ACTIVATE, CONFIGURE, change_state
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from controllers.nodes.supervisor import SupervisorNode
from models.errors import ConfigError, PoiseError
from models.nodes import realtime
from models.nodes.base import PoiseNode
from models.nodes.parameters import describe
from models.nodes.qos import EVENT
from planners.nodes.motion_planner import MotionPlannerNode
from tests import reference

pytestmark = pytest.mark.ros

NODES = (RobotDriver, StateEstimatorNode, BalanceControllerNode, SupervisorNode, MotionPlannerNode)


def _entities(node: Any) -> tuple[int, ...]:
    return tuple(len(list(kind)) for kind in (node.publishers, node.subscriptions, node.services, node.timers))


@pytest.mark.parametrize("name", reference.NODES)
def test_a_node_can_be_configured_again(bench: Any, name: str) -> None:
    node = bench.add(partial(reference.make_node, name), active=False, configured=False)
    declared = reference.parameters(node)
    for _ in range(2):
        assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS, node.message
        assert reference.parameters(node) == declared
        node.trigger_cleanup()


@pytest.mark.parametrize("kind", NODES)
def test_a_node_can_be_cycled(bench: Any, kind: type[PoiseNode]) -> None:
    node = bench.add(kind, active=False)
    configured = _entities(node)
    node.trigger_cleanup()
    bare = _entities(node)
    assert bare < configured
    for _ in range(2):
        node.trigger_configure()
        node.trigger_activate()
        assert node.active
        bench.spin(0.1)
        node.trigger_deactivate()
        assert not node.active
        bench.spin(0.05)
        assert _entities(node) == configured
        node.trigger_cleanup()
        assert _entities(node) == bare


class Failing(PoiseNode):
    """Fails half-way through its configuration."""

    error: Exception = RuntimeError("a bug")

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("failing", **kwargs)

    def configure(self) -> None:
        self.listen(String, "input", lambda message: None, EVENT)
        self.announce(String, "output", EVENT)
        raise self.error


@pytest.mark.parametrize("error", [ConfigError("no such robot"), RuntimeError("a bug")])
def test_a_failed_configuration_leaves_nothing(bench: Any, error: Exception) -> None:
    class Node(Failing):
        pass

    Node.error = error
    node = bench.add(Node, active=False)
    bare = _entities(node)
    node.trigger_configure()
    assert _entities(node) == bare
    names = {name for name, _ in bench.world.get_topic_names_and_types()}
    assert "/mouth" not in names
    assert str(error) in node.message
    Node.configure = PoiseNode.configure  # type: ignore[method-assign]
    node.trigger_configure()
    node.trigger_activate()
    assert node.active


def test_a_bug_while_activating_leaves_nothing(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(node: Any) -> None:
        raise RuntimeError("a bug")

    node = bench.add(MotionPlannerNode, active=False)
    node.trigger_cleanup()
    bare = _entities(node)
    monkeypatch.setattr(MotionPlannerNode, "activate", fail)
    node.trigger_configure()
    node.trigger_activate()
    assert not node.active
    assert _entities(node) == bare


def test_a_transition_requested_twice_is_refused_and_the_node_lives(bench: Any) -> None:
    node = bench.add(MotionPlannerNode, active=False)
    client = bench.world.create_client(ChangeState, "motion_planner/change_state")
    bench.wait(client.service_is_ready)
    answers = []
    for transition in (ACTIVATE, ACTIVATE, CONFIGURE):
        future = client.call_async(ChangeState.Request(transition=Transition(id=transition)))
        bench.wait(future.done)
        answers.append(future.result().success)
    assert answers == [True, False, False]
    assert node.active
    assert "from state 'active'" in node.values["last refusal"]


def test_a_node_that_is_at_the_goal_already_has_been_brought_there(bench: Any) -> None:
    bench.add(MotionPlannerNode)
    change_state(bench.world, lambda: bench.spin(0.01), ["motion_planner"], ACTIVATE, 30.0)
    with pytest.raises(PoiseError, match="motion_planner: refused to configure"):
        change_state(bench.world, lambda: bench.spin(0.01), ["motion_planner"], CONFIGURE, 30.0)


class LostRequests:
    """Services of a node that stays unconfigured, since no transition reaches it."""

    def __init__(self) -> None:
        self.sent = 0

    def create_client(self, kind: type, name: str) -> Any:
        return SimpleNamespace(service_is_ready=lambda: True, call_async=partial(self._call, kind))

    def destroy_client(self, client: Any) -> None: ...

    def _call(self, kind: type, request: Any) -> Any:
        if kind is ChangeState:
            self.sent += 1
            return SimpleNamespace(done=lambda: False)
        answer = SimpleNamespace(current_state=State(id=State.PRIMARY_STATE_UNCONFIGURED))
        return SimpleNamespace(done=lambda: True, result=lambda: answer)


def test_a_transition_that_twice_has_not_begun_is_requested_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Once is not enough: a busy node may answer for its state before it begins."""
    monkeypatch.setattr("bridge.ros.lifecycle.ASK_AGAIN", 0.0)
    node, sent = LostRequests(), []
    with pytest.raises(PoiseError, match="lost: no answer"):
        change_state(node, lambda: sent.append(node.sent), ["lost"], CONFIGURE, 0.2)
    assert sent[:5] == [1, 1, 1, 1, 2]  # request, question, answer, question, answer


def test_the_nodes_that_are_awaited_are_named_from_time_to_time(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bridge.ros.lifecycle.REPORT_PERIOD", 0.1)
    said: list[str] = []
    with pytest.raises(PoiseError, match="absent: no answer to 'configure'"):
        change_state(bench.world, lambda: bench.spin(0.01), ["absent"], CONFIGURE, 0.5, said.append)
    assert said and "waiting for 'configure' of absent" in said[0]


def test_ranges_of_parameters() -> None:
    bounds = describe("x", high=0.0).floating_point_range[0]
    assert (bounds.from_value < -1e300, bounds.to_value) == (True, 0.0)
    assert describe("n", integer=(0, 99)).integer_range == [IntegerRange(from_value=0, to_value=99)]


@pytest.mark.parametrize("kind", NODES)
def test_every_integer_parameter_has_a_range(bench: Any, kind: type[PoiseNode]) -> None:
    node = bench.add(kind, active=False)
    for name, parameter in node._parameters.items():
        if type(parameter.value) is int:
            assert node.describe_parameter(name).integer_range, name


@pytest.mark.parametrize(
    ("fifo", "cores", "done"),
    [(True, "[-1]", ["own"]), (False, "[-1]", []), (True, "[0]", [[0]]), (False, "[0]", [[0]])],
)
def test_a_core_of_its_own_is_only_for_who_runs_before_all_others(
    bench: Any, monkeypatch: pytest.MonkeyPatch, fifo: bool, cores: str, done: list[object]
) -> None:
    found: list[object] = []
    monkeypatch.setattr(realtime, "use_fifo", lambda priority, log: fifo)
    monkeypatch.setattr(realtime, "take_core", lambda log: found.append("own"))
    monkeypatch.setattr(realtime, "pin_to", lambda cores, log: found.append(cores))
    bench.add(PoiseNodeOfItsOwn, **{"realtime.own_core": True, "realtime.cores": cores})
    assert found == done
    found.clear()
    bench.add(PoiseNodeOfItsOwn)
    assert found == []


class PoiseNodeOfItsOwn(PoiseNode):
    """Node without a law."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("plain", **kwargs)
