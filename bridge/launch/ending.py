"""End of the graph of a real robot: it is damped where it is, or lowered first."""

from collections.abc import Callable
from typing import Literal, Protocol

from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive
from models.errors import PoiseError
from models.nodes import topics
from models.types import Mode


@dataclass(frozen=True, slots=True, config=STRICT)
class EndConfig:
    """Schema of ``bridge/config/ending.yaml``, which has units and meanings."""

    at_end: Literal["damp", "lower"]
    motion: str
    stop_limit: Positive
    plan_limit: Positive
    motion_limit: Positive
    relax_limit: Positive
    sink_time: NonNegative


class StandingRobot(Protocol):
    """The running graph, as ``Graph``."""

    mode: str
    driver_state: str
    refusal: str  # of the last text command that was sent; empty without one

    def send(self, text: str) -> None:
        """Publish a text command."""

    def call(self, service: str) -> tuple[bool, str]:
        """Call a Trigger service; returns whether it accepted, and its answer."""

    def wait_for(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        """Wait until a condition is met; ``PoiseError`` with ``what`` after ``timeout`` [s]."""

    def spin(self, duration: float) -> None:
        """Serve callbacks for a time [s]."""


def lower(robot: StandingRobot, config: EndConfig) -> None:
    """End a walk or a motion, move to a low posture, and sink from there.

    ``PoiseError`` says why a robot cannot be lowered: it does not stand by itself, the motion to the low posture is
    refused, or a step takes too long.
    """
    if robot.mode in (Mode.WALK.value, Mode.MOTION.value):
        robot.send("stop")
        robot.wait_for(lambda: robot.mode == Mode.STAND.value, config.stop_limit, "standing after the stop")
    _check_stands(robot)
    robot.send(config.motion)
    began = f"doing '{config.motion}'"
    robot.wait_for(lambda: robot.mode != Mode.STAND.value or bool(robot.refusal), config.plan_limit, began)
    robot.wait_for(lambda: robot.mode != Mode.MOTION.value, config.motion_limit, f"through '{config.motion}'")
    if robot.refusal:  # by the supervisor, or by the planner after that
        raise PoiseError(f"the robot is not lowered, it is damped: {robot.refusal}")
    _check_stands(robot)  # a velocity may have begun a walk meanwhile
    accepted, answer = robot.call(topics.START_RELAX)
    if not accepted:
        raise PoiseError(answer)
    robot.wait_for(lambda: robot.driver_state == topics.DAMPED, config.relax_limit, "damped")
    robot.spin(config.sink_time)


def _check_stands(robot: StandingRobot) -> None:
    """``PoiseError`` for a robot that does not stand."""
    if robot.mode != Mode.STAND.value:
        raise PoiseError(f"the robot is not lowered from mode '{robot.mode}': it is damped")
