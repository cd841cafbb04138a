"""What is done to a robot besides faults of its sensors and motors; what is done to its solver is here."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from unittest.mock import patch

import numpy as np
from msgspec.structs import replace

from benchmarks.fault_acts_commands import COMMANDS
from benchmarks.fault_acts_trajectories import TRAJECTORIES
from benchmarks.fault_acts_world import WORLD
from benchmarks.fault_doing import Act, Doing
from bridge.closed_loop import ClosedLoop
from controllers.balance import BalanceController


def _solver(loop: ClosedLoop) -> BalanceController:
    if not isinstance(loop.controller, BalanceController):
        raise TypeError("another controller than the packaged one")
    return loop.controller


def _spoiled(loop: ClosedLoop, ticks: int) -> Doing:
    """NaN in the gradient of the QP for some ticks."""
    builder = _solver(loop).whole_body.builder
    build = builder.build

    def spoil(*arguments: object) -> object:
        qp = build(*arguments)  # type: ignore[arg-type]  # handed through
        qp.gradient[0], qp.finite = np.nan, None
        return qp

    with ExitStack() as stack:
        stack.enter_context(patch.object(builder, "build", spoil))
        for _ in range(ticks):
            yield None


def _contradicted(loop: ClosedLoop) -> Doing:
    """For half a second the limits of a joint contradict each other: faster than 1 rad/s^2, slower than -1."""
    builder = _solver(loop).whole_body.builder
    build = builder.build

    def contradict(*arguments: object) -> object:
        qp = build(*arguments)  # type: ignore[arg-type]  # handed through
        soft = np.flatnonzero(qp.soft)[0]
        qp.lower[soft], qp.upper[soft] = 1.0, -1.0
        return qp

    with patch.object(builder, "build", contradict):
        for _ in range(500):
            yield None


def _nan_torques(loop: ClosedLoop, ticks: int) -> Doing:
    """The controller hands torques to the drivers that are no numbers."""
    controller = loop.controller
    step = controller.step

    def spoil(*arguments: object) -> object:
        result = step(*arguments)  # type: ignore[arg-type]  # handed through
        return replace(result, command=replace(result.command, tau=np.full_like(result.command.tau, np.nan)))

    with patch.object(controller, "step", spoil):
        for _ in range(ticks):
            yield None


ACTS: Mapping[str, Act] = {
    "contradict": _contradicted,
    "spoil_once": lambda loop: _spoiled(loop, 1),
    "spoil": lambda loop: _spoiled(loop, 100),
    "nan_once": lambda loop: _nan_torques(loop, 1),
    "nan_torque": lambda loop: _nan_torques(loop, 200),
    **TRAJECTORIES,
    **COMMANDS,
    **WORLD,
}
"""By the name that a row gives them."""
