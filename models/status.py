"""Status records of the stages: input of the supervisor and of clients, within one process and between processes.

``models.nodes.status`` converts them to messages. Diagnostics repeat them as text for operators; no program parses it.
"""

import math
from enum import Enum
from typing import Annotated

from msgspec import Meta, Struct

from models.types import Mode, SolveStatus

#: Advice for recovery after a fall
GET_UP = (
    "in simulation 'poise reset' puts it back on its feet; "
    "on hardware hang it from a gantry and call 'poise start prepare'"
)
Count = Annotated[int, Meta(ge=0)]


class Status(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of the records: immutable, each field typed and checked when a message is read."""


class ControlStatus(Status, frozen=True):
    """Whole-body controller."""

    active: bool  # it publishes commands
    solve: SolveStatus  # origin of the newest command; meaningful while ``active``
    overruns: Count  # consecutive ticks over the time budget
    joint_fault: str  # faulty motor or encoder, with values; empty without a fault
    stepping: bool = False  # the robot walks or has not yet come to a standstill
    gait_silent: bool = False  # no command from a gait planner
    tick_median_us: float = math.nan  # median duration of the last ticks; NaN before the first [us]
    tick_tail_us: float = math.nan  # their 99th percentile [us]


class EstimatorStatus(Status, frozen=True):
    """State estimator."""

    coasting_since: Count | None  # stamp of the last usable sample of IMU and joints [ns]; None while usable


class GaitStatus(Status, frozen=True):
    """Gait planner."""

    ready: bool  # the robot can walk
    settled: bool  # the robot stands still
    limited: str = ""  # how the commanded velocity exceeds the limits of the gait; empty within the limits
    blocked: str = ""  # why the ground ahead stops the walk at a commanded velocity; empty while it does not
    unmapped: str = ""  # why the walk does not use the required map of the ground; empty otherwise

    @property
    def remarks(self) -> str:
        """Why the walk deviates from the command or does not use the map; empty otherwise."""
        return "; ".join(filter(None, (self.blocked or self.limited, self.unmapped)))


class MotionState(Enum):
    """Stage of a requested motion."""

    REDUCED = "reduced"  # planned, but smaller than requested; it runs next
    RUNNING = "running"
    DONE = "done"
    ENDED = "ended"  # ended early
    REFUSED = "refused"


class MotionStatus(Status, frozen=True):
    """Change of a motion, from the motion planner (refusals and reductions) and the controller."""

    state: MotionState
    request: str = ""  # id of the request or trajectory, if given
    reason: str = ""  # of a refusal, a reduction or an early end

    def __str__(self) -> str:
        return ": ".join(part for part in (self.state.value, self.request, self.reason) if part)


class RouteState(Enum):
    """Stage of a walk to a goal."""

    RUNNING = "running"
    DONE = "done"
    ENDED = "ended"
    REFUSED = "refused"


class RouteStatus(Status, frozen=True):
    """Change of a walk to a goal or along given footsteps."""

    state: RouteState
    footsteps: Count = 0  # number of footsteps when a route begins
    reason: str = ""  # of a refusal, or of an end before the goal

    def __str__(self) -> str:
        more = f"{self.footsteps} footsteps" if self.state is RouteState.RUNNING else self.reason
        return f"{self.state.value}: {more}" if more else self.state.value


class SupervisorStatus(Status, frozen=True):
    """Supervisor."""

    robot: str  # profile of the robot
    mode: Mode
    refused: Count  # refused text commands since the start
    refusal: str  # reason of the last refusal
    faults: tuple[str, ...]  # latched
    holds: tuple[str, ...] = ()  # present faults that clear when their cause ends
    preflight: tuple[str, ...] = ()  # findings of the last preflight check
    fallen: bool = False  # the robot lies on the ground
    motion: str = ""  # requested or running motion
    answered: Count = 0  # requests and text commands answered since the start
    answer: str = ""  # answer to the last one
    locks: tuple[str, ...] = ()  # active locks by name; they block sources of commands
    obstacle: str = ""  # how an obstacle limits the walk; empty without a limit


class StartStatus(Status, frozen=True):
    """Start-up sequence and monitors of a real robot."""

    state: str  # state of ``bridge/driver/startup.py``
    waits_for: str = ""  # event that ends the state; empty without one
    warnings: tuple[str, ...] = ()  # of the monitors; no effect
    holds: tuple[str, ...] = ()  # of the monitors; no motion or walk may start, and a running walk ends
    values: tuple[str, ...] = ()  # latest values of the monitors, with name and unit
    remote: str = ""  # time of the last signal of the remote controller; empty without one


class NodeStatus(Status, frozen=True):
    """Heartbeat of a node and its QoS mismatches; each tuple has one entry per mismatch."""

    name: str  # without namespace
    topics: tuple[str, ...] = ()  # topics with an incompatible endpoint, by the names used in the node
    ends: tuple[str, ...] = ()  # kind of that endpoint, ``publisher`` or ``subscriber``
    policies: tuple[str, ...] = ()  # QoS policy that differs
