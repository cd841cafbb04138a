"""End of the graph of a real robot: the robot is damped in its present posture, or lowered first."""

from collections.abc import Callable
from typing import Literal, Protocol

from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive
from models.errors import PoiseError
from models.nodes import topics
from models.types import Mode


@dataclass(frozen=True, slots=True, config=STRICT)
class EndConfig:
    """Schema of ``bridge/config/ending.yaml``; units and meanings are given there."""

    at_end: Literal["damp", "lower"]
    motion: str
    stop_limit: Positive
    plan_limit: Positive
    motion_limit: Positive
    relax_limit: Positive
    sink_time: NonNegative


class StandingRobot(Protocol):
    """Interface of the running graph; implemented by ``Graph``."""

    mode: str
    driver_state: str
    refusal: str  # reason why the last text command was refused; empty if it was not

    def send(self, text: str) -> None:
        """Publish a text command."""

    def call(self, service: str) -> tuple[bool, str]:
        """Call a Trigger service; returns whether the request was accepted, and the answer."""

    def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Wait until a condition is met; ``PoiseError`` with ``what`` after ``timeout`` [s]."""

    def spin(self, duration: float) -> None:
        """Serve callbacks for a time [s]."""


def lower(robot: StandingRobot, config: EndConfig) -> None:
    """Stop a walk or a motion, move to a low posture, and relax the robot there until it is damped and has sunk.

    Raises ``PoiseError`` with the reason when the robot cannot be lowered: it does not stand without support, the
    motion to the low posture is refused, or a step takes too long.
    """
    if robot.mode in (Mode.WALK.value, Mode.MOTION.value):
        robot.send("stop")
        robot.wait_for(lambda: robot.mode == Mode.STAND.value, config.stop_limit, "standing after the stop")
    _check_stands(robot)
    robot.send(config.motion)
    began = f"doing '{config.motion}'"
    robot.wait_for(lambda: robot.mode != Mode.STAND.value or bool(robot.refusal), config.plan_limit, began)
    robot.wait_for(lambda: robot.mode != Mode.MOTION.value, config.motion_limit, f"through '{config.motion}'")
    if robot.refusal:  # by the supervisor, or later by the planner
        raise PoiseError(f"the robot is not lowered, it is damped: {robot.refusal}")
    _check_stands(robot)  # a velocity command may have started a walk
    accepted, answer = robot.call(topics.START_RELAX)
    if not accepted:
        raise PoiseError(answer)
    robot.wait_for(lambda: robot.driver_state == topics.DAMPED, config.relax_limit, "damped")
    robot.spin(config.sink_time)


def _check_stands(robot: StandingRobot) -> None:
    """Raise ``PoiseError`` when the robot does not stand."""
    if robot.mode != Mode.STAND.value:
        raise PoiseError(f"the robot is not lowered from mode '{robot.mode}': it is damped")
