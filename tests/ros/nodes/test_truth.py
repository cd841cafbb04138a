"""What controls has no way to the truth through an import; ``Eyes.check_truth`` has the topics of running graphs."""

import json
import os
import subprocess
import sys

import pytest

from bridge.ros.environment import free_domain, graph_environment

pytestmark = pytest.mark.ros

BUILD = """
import json, sys, rclpy
from bridge.nodes.control import main
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from controllers.nodes.supervisor import SupervisorNode
from controllers.stack import ControlStack
from planners.nodes.gait_planner import GaitPlannerNode
from planners.nodes.motion_planner import MotionPlannerNode
rclpy.init(args=[])
stack = ControlStack()
gait, apart = GaitPlannerNode(stack), BalanceControllerNode(stack)
nodes = [gait, apart, StateEstimatorNode(apart.on_state, stack), SupervisorNode(), MotionPlannerNode()]
for node in nodes:
    node.trigger_configure()
    node.trigger_activate()
    assert node.active
topics = sorted({subscription.topic_name for node in nodes for subscription in node.subscriptions})
print(json.dumps([topics, sorted(sys.modules)]))
"""


@pytest.mark.long
def test_no_node_class_asks_for_it_or_imports_the_simulator() -> None:
    """Built, configured and active, in a process that imports nothing else."""
    environment = {**os.environ, **graph_environment(domain_id=free_domain())}
    built = subprocess.run(
        [sys.executable, "-c", BUILD], capture_output=True, text=True, check=True, timeout=120, env=environment
    )
    asked, modules = json.loads(built.stdout.splitlines()[-1])
    assert "/joint_states" in asked  # it really looked
    assert not [topic for topic in asked if "truth" in topic]
    assert "controllers.balance.controller" in modules
    assert [name for name in modules if "mujoco" in name] == []
    composed = {"bridge", "bridge.nodes", "bridge.nodes.control"}
    assert {name for name in modules if name.split(".")[0] == "bridge"} == composed
