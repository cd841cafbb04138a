"""Limits of the actions are parameters of their node, and a failure names the limit."""

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.action.client import ActionClient
from std_msgs.msg import String

from bridge.nodes.action_server import ActionServerNode, WalkTo
from bridge.ros.goals import ActionsConfig
from models.config import default_config
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.interfaces import interface
from models.nodes.qos import LATCHED
from models.types import CommandReply

try:
    ExecuteMotion = interface("poise_interfaces", "action", "ExecuteMotion")
except PoiseError as _error:
    pytest.skip(str(_error), allow_module_level=True)

pytestmark = pytest.mark.ros


def test_a_goal_waits_for_its_answer_as_long_as_the_parameter_says(bench: Any) -> None:
    node = bench.add(ActionServerNode, answer_timeout=0.2)
    bench.world.create_publisher(String, topics.MODE, LATCHED).publish(String(data="stand"))
    bench.wait(lambda: node._turns.robot.mode == "stand")
    client = ActionClient(bench.world, ExecuteMotion, "execute_motion")
    bench.wait(client.server_is_ready)
    bench.spin(0.2)
    sent = client.send_goal_async(ExecuteMotion.Goal(motion="wave"))
    bench.wait(sent.done)
    ended = sent.result().get_result_async()
    bench.wait(ended.done, 4.0)  # less than the packaged answer_timeout
    result = ended.result().result
    assert not result.success and "service command is absent" in result.message
    client.destroy()


def test_a_limit_out_of_range_is_refused_by_name(bench: Any) -> None:
    with pytest.raises(Exception, match="answer_timeout"):
        bench.add(ActionServerNode, answer_timeout=-1.0)


def test_a_walk_that_does_not_stop_fails_with_the_time_waited() -> None:
    async def set_mode(mode: str) -> CommandReply:
        return CommandReply(True, "stand: requested")

    async def until(condition: Callable[[], bool], timeout: float) -> bool:
        return condition()

    config = default_config(ActionsConfig, "bridge", "actions")
    robot: Any = SimpleNamespace(mode="walk", route=[], config=config, begin=list, set_mode=set_mode, until=until)
    handle: Any = SimpleNamespace(request=SimpleNamespace(goal=None))
    turn: Any = SimpleNamespace(ended="replaced")
    outcome = asyncio.run(WalkTo(robot, None, list).run(handle, turn))
    assert not outcome.success and outcome.message.startswith("replaced; no standstill")
    assert outcome.message.endswith(f"within {config.stand_timeout:g} s")
