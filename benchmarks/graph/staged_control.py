"""The control process with probes: ``latency_file`` of ``state_estimator`` names the file of the stages' times."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bridge.driver import probes
from bridge.driver.probes import StageProbe
from bridge.nodes.control import factories
from controllers.nodes.balance_controller import BalanceControllerNode
from controllers.nodes.state_estimator import StateEstimatorNode
from models.nodes import topics
from models.nodes.parameters import describe
from models.nodes.spin import run
from models.types import Reference, RobotState
from planners.gait.state import Rest
from planners.nodes.gait_planner import GaitPlannerNode

PROBE = StageProbe()  # of this process: one tick at a time goes through all three nodes


class StagedEstimator(StateEstimatorNode):
    """Notes when joints arrive."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        text = describe("Where to write when each stage of a tick ended; empty for nowhere")
        self._file = str(self.declare_parameter("latency_file", "", text).value)

    def listen(self, kind: type, topic: str, callback: Callable[[Any], None], qos: Any, **options: bool) -> None:
        """Subscribe; the joints' callback begins a row."""
        if topic != topics.JOINT_STATES:
            super().listen(kind, topic, callback, qos, **options)
            return

        def on_joints(data: Any) -> None:
            PROBE.begin()
            callback(data)

        super().listen(kind, topic, on_joints, qos, **options)

    def deactivate(self) -> None:
        super().deactivate()
        if self._file:
            PROBE.save(Path(self._file))


class StagedPlanner(GaitPlannerNode):
    """Notes when the reference of a walk is there."""

    def configure(self) -> None:
        """Build the gait; the end of its tick is recorded from outside."""
        super().configure()
        plan = self._law.step

        def planned(state: RobotState, dt: float, rest: Rest | None = None) -> Reference:
            reference = plan(state, dt, rest)
            PROBE.note(probes.PLANNED)
            return reference

        self._law.step = planned  # type: ignore[method-assign]


class StagedController(BalanceControllerNode):
    """Notes when a state comes, when the law begins and ends, and when the command is out."""

    def configure(self) -> None:
        super().configure()
        self._stack.control = _noted(self._stack.control)  # type: ignore[method-assign]
        self._command.publish = _followed(self._command.publish)

    def on_state(self, state: RobotState, stamp: int) -> None:
        PROBE.state(stamp)
        super().on_state(state, stamp)
        PROBE.touch(self._stack.scheduled)


def _noted(step: Callable[..., Any]) -> Callable[..., Any]:
    """A law's tick, its begin and end recorded; a gait planner within it moves the begin."""

    def recorded(*arguments: Any) -> Any:
        PROBE.note(probes.PLANNED)
        result = step(*arguments)
        PROBE.note(probes.SOLVED)
        return result

    return recorded


def _followed(publish: Callable[[bytes], None]) -> Callable[[bytes], None]:

    def followed(data: bytes) -> None:
        publish(data)
        PROBE.note(probes.COMMANDED)

    return followed


if __name__ == "__main__":
    sys.exit(run(factories(StagedPlanner, StagedController, StagedEstimator)))
