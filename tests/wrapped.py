"""The robot in lockstep with a controller that tests look into, and what is compared of its log."""

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from bridge.closed_loop import ClosedLoop
from controllers.balance.controller import BalanceController
from models.robot_model import RobotModel
from models.types import ControlResult, JointCommand, JointTrajectory, Reference, RobotState, SolveStatus


class Wrapped:
    """The balance controller, with a hook on every result."""

    def __init__(self, model: RobotModel) -> None:
        self.inner = BalanceController(model)
        self.states: list[RobotState] = []
        self.commands: list[JointCommand] = []
        self.damped = False
        self.limp = False

    @property
    def motion_active(self) -> bool:
        return self.inner.motion_active

    @property
    def reference(self) -> Reference:
        return self.inner.reference

    def reset(self, state: RobotState) -> None:
        self.states.clear()
        self.commands.clear()
        self.inner.reset(state)

    def follow(self, trajectory: JointTrajectory) -> None:
        self.inner.follow(trajectory)

    def stop_motion(self) -> None:
        self.inner.stop_motion()

    def step(self, state: RobotState, dt: float) -> ControlResult:
        result = self.inner.step(state, dt)
        if self.limp:
            command = result.command
            result = replace(result, command=JointCommand(state.q[7:].copy(), 0.0 * command.v, 0.0 * command.tau))
        if self.damped:
            result = replace(result, status=SolveStatus.DAMPED)
        self.states.append(state)
        self.commands.append(result.command)
        return result


def columns(loop: ClosedLoop) -> NDArray[np.float64]:
    """Everything in the log that the seed decides."""
    return np.column_stack([getattr(loop.log, name) for name in loop.log.names if name != "solve_time"])
