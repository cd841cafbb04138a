"""``state_estimator`` and ``balance_controller`` in one process: the state is handed over as an object.

Which of the two deployments is the default was decided by the latency benchmark; see ``docs/graph.md``.
"""

from __future__ import annotations

import sys

from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from models.nodes.spin import run
from models.types import RobotState


def main(args: list[str] | None = None) -> None:
    """Run both nodes until a signal."""
    made: list[BalanceControllerNode] = []

    def controller() -> BalanceControllerNode:
        made.append(BalanceControllerNode(local=True))
        return made[0]

    def hand_over(state: RobotState, stamp: int) -> None:
        made[0].on_state(state, stamp)

    sys.exit(run([controller, lambda: StateEstimatorNode(hand_over)], args))


if __name__ == "__main__":
    main()
