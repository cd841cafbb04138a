"""Control process with probes: ``latency_file`` of ``state_estimator`` is the file for the times of the stages."""

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
from models.nodes.parameters import declare
from models.nodes.spin import run
from models.types import RobotState
from planners.nodes.gait_planner import GaitPlannerNode

PROBE = StageProbe()  # one per process: a tick passes all three nodes before the next


def record(call: Callable[..., Any], *, begins: int | None = None, ends: int | None = None) -> Callable[..., Any]:
    """Wrap ``call`` to record the columns ``begins`` and ``ends`` of ``StageProbe`` before and after it."""

    def recorded(*arguments: Any) -> Any:
        if begins is not None:
            PROBE.note(begins)
        result = call(*arguments)
        if ends is not None:
            PROBE.note(ends)
        return result

    return recorded


class StagedEstimator(StateEstimatorNode):
    """Records the arrival of joint states."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        text = "File for the end times of the stages of each tick; empty for none"
        self._file = declare(self, "latency_file", "", text)

    def listen(self, kind: type, topic: str, callback: Callable[[Any], None], qos: Any, **options: Any) -> None:
        """Subscribe; the callback of joint states begins a row."""

        def on_joints(data: Any) -> None:
            PROBE.begin()
            callback(data)

        super().listen(kind, topic, on_joints if topic == topics.JOINT_STATES else callback, qos, **options)

    def deactivate(self) -> None:
        super().deactivate()
        if self._file:
            PROBE.save(Path(self._file))


class StagedPlanner(GaitPlannerNode):
    """Records when the reference of a walk is available."""

    def configure(self) -> None:
        super().configure()
        self._law.step = record(self._law.step, ends=probes.PLANNED)  # type: ignore[method-assign]


class StagedController(BalanceControllerNode):
    """Records arrival of the state, begin and end of the law, and the command.

    A gait planner inside the law overwrites the begin.
    """

    def configure(self) -> None:
        super().configure()
        law = record(self._stack.control, begins=probes.PLANNED, ends=probes.SOLVED)
        self._stack.control = law  # type: ignore[method-assign]
        self._command.publish = record(self._command.publish, ends=probes.COMMANDED)

    def on_state(self, state: RobotState, stamp: int) -> None:
        PROBE.state(stamp)
        super().on_state(state, stamp)
        PROBE.touch(self._stack.scheduled)


if __name__ == "__main__":
    sys.exit(run(factories(StagedPlanner, StagedController, StagedEstimator)))
