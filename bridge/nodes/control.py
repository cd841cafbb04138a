"""Estimator, gait planner and controller as three nodes in one process, the default of ``docs/graph.md``."""

import sys
from collections.abc import Callable
from typing import Any

from controllers.input_log import InputLog
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from controllers.stack import ControlStack
from models.nodes.spin import run
from models.types import RobotState
from planners.nodes.gait_planner import GaitPlannerNode


def main(args: list[str] | None = None) -> None:
    """Run the three nodes until a signal."""
    sys.exit(run(factories(), args))


def factories(
    planner: type[GaitPlannerNode] = GaitPlannerNode,
    law: type[BalanceControllerNode] = BalanceControllerNode,
    observer: type[StateEstimatorNode] = StateEstimatorNode,
) -> list[Callable[[], Any]]:
    """Constructors of gait planner, controller and estimator, in this order; subclasses may replace them."""
    stack = ControlStack(log=InputLog())
    nodes: dict[str, Any] = {}

    def make(name: str, kind: Callable[..., Any], *arguments: Any) -> Callable[[], Any]:
        def construct() -> Any:
            nodes[name] = kind(*arguments)
            return nodes[name]

        return construct

    def tick(state: RobotState, stamp: int) -> None:
        nodes["gait"].before_tick(state.t)
        nodes["law"].on_state(state, stamp)
        nodes["gait"].publish(stamp)

    return [make("gait", planner, stack), make("law", law, stack), make("observer", observer, tick, stack)]


if __name__ == "__main__":
    main()
