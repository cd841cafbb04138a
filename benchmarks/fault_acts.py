"""What is done to a robot besides faults of its sensors and motors: to its solver, by its users, by its world."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from unittest.mock import patch

import numpy as np

from bridge.closed_loop import ClosedLoop
from controllers.balance import BalanceController
from models.types import CommandReply

Doing = Iterator[CommandReply | None]
"""One step of an act before each tick; what was answered, where something was asked."""

KICK_PERIOD, KICK_TIME, KICK_SPEED = 4.0, 0.1, 0.2
"""Time between two kicks, length of each [s], and the velocity that it gives [m/s]."""


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


def _says(text: str) -> Callable[[ClosedLoop], Doing]:
    def act(loop: ClosedLoop) -> Doing:
        yield loop.command(text)

    return act


def _flood(loop: ClosedLoop) -> Doing:
    """Ten texts in every tick of a second."""
    for _ in range(1000):
        for _ in range(10):
            loop.command("nonsense")
        yield None


def _calibrate(loop: ClosedLoop) -> Doing:
    yield loop.calibrate("imu")


def _busy(loop: ClosedLoop) -> Doing:
    loop.command("squat")
    yield loop.command("wave")


def _kick(loop: ClosedLoop) -> Doing:
    """A kick from another side every four seconds."""
    force = loop.robot.mass * KICK_SPEED / KICK_TIME
    for number in range(1000):
        angle = 2.4 * number  # [rad] the golden angle: never the same side
        loop.apply_push((force * np.cos(angle), force * np.sin(angle), 0.0), KICK_TIME)
        for _ in range(round(KICK_PERIOD / loop.plant.period)):
            yield None


def _knock_down(loop: ClosedLoop) -> Doing:
    """A push that nothing can take."""
    loop.apply_push((12.0 * loop.robot.mass, 0.0, 0.0), 0.3)
    yield None


ACTS: dict[str, Callable[[ClosedLoop], Doing]] = {
    "contradict": _contradicted,
    "spoil_once": lambda loop: _spoiled(loop, 1),
    "spoil": lambda loop: _spoiled(loop, 100),
    "nan_once": lambda loop: _nan_torques(loop, 1),
    "nan_torque": lambda loop: _nan_torques(loop, 200),
    "long_text": _says("x" * 1_000_000),
    "unknown_text": _says("fly"),
    "squat": _says("squat"),
    "stand": _says("stand"),
    "flood": _flood,
    "calibrate": _calibrate,
    "busy": _busy,
    "kick": _kick,
    "knock_down": _knock_down,
}
"""By the name that a row gives them."""
