"""What controls has no way to the truth: not over the graph, not through an import, in either deployment."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bridge.launch.graph import Graph
from bridge.ros.environment import free_domain, graph_environment
from bridge.ros.processes import Processes
from models.nodes import topics

pytestmark = [pytest.mark.ros, pytest.mark.graph]

NODES = ("balance_controller", "state_estimator", "gait_planner", "supervisor", "motion_planner")

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


@pytest.mark.parametrize("processes", ["shared", "separate"])
def test_nobody_that_controls_listens_to_it(tmp_path: Path, processes: Processes) -> None:
    """From the first step to the end of a motion; in lockstep, so that a busy machine decides nothing."""
    readers: set[str] = set()
    asked: set[str] = set()
    with Graph(
        "g1", lockstep=True, processes=processes, domain_id=free_domain(), log=tmp_path / "log", say=lambda text: None
    ) as graph:

        def look() -> None:
            truth = graph.node.get_subscriptions_info_by_topic(f"/{topics.GROUND_TRUTH}")
            # An observer of another test, or a person's own tool, may read it; those that control may not.
            readers.update(info.node_name for info in truth if info.node_name in NODES)
            for name in set(NODES) & set(graph.node.get_node_names()):
                asked.update(topic for topic, _ in graph.node.get_subscriber_names_and_types_by_node(name, "/"))

        def until(mode: str) -> None:
            def reached() -> bool:
                look()
                return graph.mode == mode

            graph.wait_for(reached, 120.0, mode)

        graph.wait_standing(120.0)
        graph.send("wave")
        until("motion")
        until("stand")
        assert set(NODES) <= set(graph.node.get_node_names())
        needed = {f"/{topic}" for topic in (topics.JOINT_STATES, topics.IMU_RAW, topics.MODE)}

        def discovered() -> bool:
            look()
            return needed <= asked

        graph.wait_for(discovered, 60.0, "discovery of the subscriptions")
        assert readers == set()
        assert not [topic for topic in asked if "truth" in topic]
        for module, pid in graph.pids.items():
            linked = "libmujoco" in Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")
            assert linked == (module == "bridge.nodes.robot_driver")
