"""Commands that come at the wrong time, from the wrong hand, or are no numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from benchmarks.fault_doing import Act, Doing, asked, pause, says, unmet
from bridge.closed_loop import ClosedLoop
from bridge.fault_plan import Fault
from controllers.arbitration import Arbiter
from controllers.command_signature import KEY_BYTES, Signer, Verifier
from models.constants import NANOSECONDS
from models.types import CommandReply, Mode

WALL_TIME, WINDOW = 1.7e9, 0.1
"""Wall time at the start of the simulation, and how far stamps of signed commands may be from it [s]."""

KEY, OTHER_KEY = bytes(KEY_BYTES), bytes([1]) * KEY_BYTES

PATIENCE = 0.2
"""Until a robot has damped [s]."""


def _velocity(forward: float) -> Act:
    def act(loop: ClosedLoop) -> Doing:
        yield asked(lambda: loop.set_velocity(forward, 0.0, 0.0))

    return act


def _calibrate(loop: ClosedLoop) -> Doing:
    yield loop.calibrate("imu")


def _stand_up(loop: ClosedLoop) -> Doing:
    """A robot that walks is asked to stand, which it may only between two steps."""
    yield loop.command("stand")
    while loop.mode is Mode.WALK:
        yield None
    if loop.gait.walking:
        yield unmet("stands in the middle of a step")


def _walk_damped(loop: ClosedLoop) -> Doing:
    """A robot that has damped is asked to walk."""
    loop.inject(Fault("joint_states", "off", end=PATIENCE))
    yield from pause(loop, 2.0 * PATIENCE)
    yield loop.command("walk")


def _stand_fallen(loop: ClosedLoop) -> Doing:
    """A robot that lies on the ground is asked to stand."""
    loop.apply_push((12.0 * loop.robot.mass, 0.0, 0.0), 0.3)
    yield from pause(loop, 1.5)
    yield loop.command("stand")


def _flood(loop: ClosedLoop) -> Doing:
    """Ten texts in every tick of a second."""
    for _ in range(1000):
        for _ in range(10):
            loop.command("nonsense")
        yield None


def _signed(lines: Callable[[Callable[[], int]], tuple[str, ...]]) -> Act:
    """A robot that takes signed commands only gets some lines, given the wall time [ns]."""

    def act(loop: ClosedLoop) -> Doing:
        def clock() -> int:
            return round((WALL_TIME + loop.t) * NANOSECONDS)

        verifier = Verifier(KEY, WINDOW, clock)
        yield from pause(loop, 2.0 * WINDOW)  # who has just begun to listen takes nothing

        for line in lines(clock):
            heard: list[CommandReply] = []
            opened = asked(lambda: heard.append(loop.command(verifier.verify(line).text)))  # noqa: B023
            yield heard[0] if heard else opened

    return act


def _replayed(clock: Callable[[], int]) -> tuple[str, ...]:
    line = Signer(KEY, "teleop", clock).sign("walk")
    return line, line


def _commanders(loop: ClosedLoop) -> Doing:
    """While a person steers, the navigation says a word."""
    arbiter = Arbiter()
    arbiter.repeat("teleop", (0.1, 0.0, 0.0), loop.t)
    loop.set_velocity(*arbiter.velocity(loop.t))
    yield from pause(loop, 0.1)
    refused = asked(lambda: arbiter.require("autonomy", loop.t))
    yield loop.command("stop") if refused.accepted else refused


def _locked(loop: ClosedLoop) -> Doing:
    """While the lock is closed, a person steers."""
    arbiter = Arbiter()
    arbiter.lock("pause", True, loop.t)
    refused = asked(lambda: arbiter.repeat("teleop", (0.1, 0.0, 0.0), loop.t))
    loop.set_velocity(*arbiter.velocity(loop.t))
    yield refused


COMMANDS: Mapping[str, Act] = {
    "long_text": says("x" * 1_000_000),
    "unknown_text": says("fly"),
    "squat": says("squat"),
    "stand": _stand_up,
    "busy": says("squat", "wave"),
    "walk_from_squat": says("squat", "walk"),
    "flood": _flood,
    "calibrate": _calibrate,
    "forward": _velocity(0.3),
    "nan_velocity": _velocity(math.nan),
    "walk_damped": _walk_damped,
    "stand_fallen": _stand_fallen,
    "unsigned": _signed(lambda clock: ("walk",)),
    "forged": _signed(lambda clock: (Signer(OTHER_KEY, "teleop", clock).sign("walk"),)),
    "replayed": _signed(_replayed),
    "commanders": _commanders,
    "locked": _locked,
}
"""By the name that a row gives them."""
