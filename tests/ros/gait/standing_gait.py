"""A gait planner's node without a law, whose robot stands on the spot, whatever it plans."""

from typing import Any

from controllers.stack import ControlStack
from models.robot_model import RobotModel
from models.types import RobotState
from planners.nodes.gait_planner import GaitPlannerNode
from tests.support import standing

MS = 1_000_000  #: A millisecond [ns]


class GaitOnly(ControlStack):
    """A stack without a law: the test says when the gait follows its commands."""

    walking = False


class StandingGait:
    """The node, and the passing of time; ``stamp`` [ns]."""

    def __init__(self, bench: Any, model: RobotModel) -> None:
        self.bench, self.model, self.stamp = bench, model, 10**9
        self.stack = GaitOnly()
        self.node = bench.add(lambda **kwargs: GaitPlannerNode(self.stack, **kwargs))

    @property
    def state(self) -> RobotState:
        return standing(self.model, 1e-9 * self.stamp)

    def tick(self, ms: int) -> None:
        """Let time pass, in one tick."""
        self.stamp += ms * MS
        self.node.before_tick(self.state.t)
        self.stack.set_state(self.state)
        if (held := self.stack.snapshot.held) is not None:
            self.stack.gait.set_velocity(*held)
        self.stack.gait.step(self.state, 1e-3 * ms)
        self.node.publish(self.stamp)
