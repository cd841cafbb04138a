"""Estimator, gait planner and controller in one process: state, reference and schedule go over as objects.

Planners and controllers do not know each other; here they are put together. Why this is the default deployment was
decided by the latency benchmark; see ``docs/graph.md``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from models.applied import Applied
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
    """What makes gait planner, controller and estimator, in this order; subclasses of theirs may stand in."""
    gaits: list[GaitPlannerNode] = []
    controllers: list[BalanceControllerNode] = []
    estimators: list[StateEstimatorNode] = []
    applied = Applied()

    def gait() -> GaitPlannerNode:
        gaits.append(planner(applied=applied))
        return gaits[0]

    def controller() -> BalanceControllerNode:
        controllers.append(law(local=True, gait=gaits[0], applied=applied))
        return controllers[0]

    def hand_over(state: RobotState, stamp: int) -> tuple[bool, bool] | None:
        controllers[0].on_state(state, stamp)
        gaits[0].tell(stamp, state)
        controllers[0].keep(state, estimators[0].sensors, stamp)
        return controllers[0].scheduled

    def estimator() -> StateEstimatorNode:
        estimators.append(observer(hand_over, applied))
        return estimators[0]

    return [gait, controller, estimator]


if __name__ == "__main__":
    main()
