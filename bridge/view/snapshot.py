"""What the page shows of one moment."""

from __future__ import annotations

from dataclasses import dataclass

from models.types import Matrix, Vector
from planners.gait.footsteps import Foothold


@dataclass(frozen=True, slots=True)
class Snapshot:
    """One moment of the robot, as its own topics tell it; W is ``odom``.

    Attributes:
        t: Stamp of the joint states [s].
        q: Estimated configuration (nq,) [m, rad].
        v: Estimated velocity (nv,) [m/s, rad/s].
        tau: Measured joint torques (nj,) [N.m].
        wrenches: Ground reaction on each foot in its sole frame (2, 6) [N, N.m]; zero where no sensor is fitted.
        push: Observed push about the CoM in W: force, moment (6,) [N, N.m].
        footsteps: Foot (0 left, 1 right) and place of the coming footsteps in W.
        margin: Distance of the DCM inside the region from which one step brings it to rest [m]; NaN when not walking.
    """

    t: float
    q: Vector
    v: Vector
    tau: Vector
    wrenches: Matrix
    push: Vector
    footsteps: tuple[tuple[int, Foothold], ...]
    margin: float


@dataclass(frozen=True, slots=True)
class Words:
    """What the robot says of itself.

    Attributes:
        mode: Of the supervisor; empty before the first word.
        drivers: State of the joint drivers.
        phase: Of the gait.
        commander: Source in command.
        faults: Latched faults, and the messages of nodes that are not well, by node.
        tick_median: Of the controller's last ticks [us]; NaN before its first diagnostics.
        tick_tail: 99th percentile of these [us].
    """

    mode: str = ""
    drivers: str = ""
    phase: str = ""
    commander: str = ""
    faults: tuple[tuple[str, str], ...] = ()
    tick_median: float = float("nan")
    tick_tail: float = float("nan")
