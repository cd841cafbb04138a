"""Status records of the stages: input of the supervisor and the clients, within a process and between several.

``models.nodes.status`` converts them to messages. Diagnostics repeat them as text for people; no program parses these.
"""

import math
from enum import Enum
from typing import Annotated

from msgspec import Meta, Struct

from models.types import Mode, SolveStatus

#: The way back of a robot that has fallen
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
    joint_fault: str  # motor or encoder at fault, with figures; empty without one
    stepping: bool = False  # it walks, or has not yet come to a standstill
    gait_silent: bool = False  # no gait planner commands it
    tick_median_us: float = math.nan  # of the last ticks; NaN before the first [us]
    tick_tail_us: float = math.nan  # their 99th percentile [us]


class EstimatorStatus(Status, frozen=True):
    """State estimator."""

    coasting_since: Count | None  # stamp of the last usable sample of IMU and joints [ns]; None while usable


class GaitStatus(Status, frozen=True):
    """Gait planner."""

    ready: bool  # the robot can walk
    settled: bool  # it stands still
    limited: str = ""  # how the commanded velocity exceeds the limits of the gait; empty within them
    blocked: str = ""  # why it stops at a velocity, or stands, in front of ground; empty while it does not

    unmapped: str = ""  # why it walks without the map of the ground that it should have; empty with it

    @property
    def remarks(self) -> str:
        """Why it does not walk as commanded, or without a map; empty while it does as it should."""
        return "; ".join(filter(None, (self.blocked or self.limited, self.unmapped)))


class MotionState(Enum):
    """Stage of a requested motion."""

    REDUCED = "reduced"  # planned, but smaller than requested; it runs next
    RUNNING = "running"
    DONE = "done"
    ENDED = "ended"  # before its end
    REFUSED = "refused"


class MotionStatus(Status, frozen=True):
    """Change of a motion, from the motion planner (refusals and reductions) and the controller."""

    state: MotionState
    request: str = ""  # request or trajectory that it belongs to, if given
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
    footsteps: Count = 0  # number of footsteps of a route that begins
    reason: str = ""  # of a refusal, or of an end before the goal

    def __str__(self) -> str:
        more = f"{self.footsteps} footsteps" if self.state is RouteState.RUNNING else self.reason
        return f"{self.state.value}: {more}" if more else self.state.value


class SupervisorStatus(Status, frozen=True):
    """Supervisor."""

    robot: str  # profile of the robot
    mode: Mode
    refused: Count  # refused text commands since the start
    refusal: str  # reason of the last one
    faults: tuple[str, ...]  # latched
    holds: tuple[str, ...] = ()  # present faults that end with their cause
    preflight: tuple[str, ...] = ()  # findings of the last preflight check
    fallen: bool = False  # the robot lies
    motion: str = ""  # requested or under way
    answered: Count = 0  # requests and text commands answered since the start
    answer: str = ""  # to the last one
    locks: tuple[str, ...] = ()  # closed ones, by name: they silence sources of commands
    obstacle: str = ""  # how an obstacle limits the walk; empty while none does


class StartStatus(Status, frozen=True):
    """Start and monitors of a real robot."""

    state: str  # of ``bridge/driver/startup.py``
    waits_for: str = ""  # what ends it; empty for nothing
    warnings: tuple[str, ...] = ()  # of the monitors, without an effect
    holds: tuple[str, ...] = ()  # of the monitors: no motion and no walk may begin, and a walk ends
    values: tuple[str, ...] = ()  # newest ones of the monitors, with name and unit
    remote: str = ""  # when the remote controller has given its last sign; empty without one


class NodeStatus(Status, frozen=True):
    """Sign of life of a node, and its QoS mismatches: one entry of each tuple per mismatch."""

    name: str  # without namespace
    topics: tuple[str, ...] = ()  # topics with an incompatible endpoint, as named in the node
    ends: tuple[str, ...] = ()  # kind of that endpoint, ``publisher`` or ``subscriber``
    policies: tuple[str, ...] = ()  # QoS policy that differs
