"""What the supervisor needs to know of the other nodes at one instant, and what is wrong with it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from controllers.supervisor_config import SupervisorConfig
from models.types import SolveStatus, Vector


class Severity(IntEnum):
    """How much a fault takes away; the most severe one wins."""

    HOLD = 1
    """No velocity and no new motion. Ends with its cause."""
    STAND = 2
    """A walk ends with its step, a motion where it is; no other begins before ``reset_faults``."""
    DAMP = 3
    """The joints are damped and stay so until ``reset_faults``. Taking all torque away is left to people."""


class Problem(NamedTuple):
    """One fault.

    Attributes:
        severity: What it takes away.
        reason: One sentence with the figure that broke the limit, or the culprit's name.
    """

    severity: Severity
    reason: str


def second_publisher(topic: str) -> str:
    """The sentence about a topic on which somebody else publishes too."""
    return f"'{topic}' has a second publisher"


def tilt(quaternion: Vector) -> float:
    """Angle between the base's z axis and the vertical.

    Args:
        quaternion: Orientation of B in W, xyzw (4,).

    Returns:
        Angle [rad], 0 when upright; NaN when the quaternion is not finite.
    """
    x, y, z, w = quaternion
    cosine = (z * z + w * w - x * x - y * y) / (x * x + y * y + z * z + w * w)
    return math.acos(min(max(cosine, -1.0), 1.0))


@dataclass(frozen=True, slots=True)
class Health:
    """Newest reports, by stamp.

    Attributes:
        state_stamp: Stamp of the newest state estimate [s].
        command_stamp: Stamp of the newest whole-body command [s].
        tilt: Base tilt from upright [rad].
        status: How the newest command came about.
        drivers_damped: Whether the joint drivers fell back to damping on their own.
        motion_active: Whether the controller is following a motion.
        overruns: Ticks in a row in which the controller took longer than its time budget.
        gait_active: Whether the robot walks, or has not yet come to a standstill.
        coasting: How long the state has been estimated without samples of the inertial unit or the joints [s].
        silent: Nodes that give no sign of life any more, apart from those that the stamps tell of.
        intruders: Sensor topics that somebody else publishes on too.
        joint_fault: What is wrong with a motor or an encoder; empty while nothing is.
    """

    state_stamp: float
    command_stamp: float
    tilt: float
    status: SolveStatus = SolveStatus.OPTIMAL
    drivers_damped: bool = False
    motion_active: bool = False
    overruns: int = 0
    gait_active: bool = False
    coasting: float = 0.0
    silent: tuple[str, ...] = ()
    intruders: tuple[str, ...] = ()
    joint_fault: str = ""

    def problems(self, config: SupervisorConfig, t: float) -> list[Problem]:
        """What is wrong, most severe first; empty when healthy.

        Args:
            config: Limits.
            t: Stamp of now [s].
        """
        found = [Problem(Severity.DAMP, reason) for reason in self._damping(config, t)]
        found += [Problem(Severity.STAND, second_publisher(topic)) for topic in self.intruders]
        return found + [Problem(Severity.HOLD, f"node '{node}' gives no sign of life") for node in self.silent]

    def _damping(self, config: SupervisorConfig, t: float) -> list[str]:
        """Faults that end standing, most telling first."""
        found = []
        if not self.tilt < config.fall_tilt:
            found.append(f"fallen: base tilt {self.tilt:.2f} rad exceeds {config.fall_tilt:.2f} rad")
        if t - self.state_stamp > config.state_timeout:
            found.append(f"state estimate older than {config.state_timeout:.3f} s")
        if not self.coasting <= config.coasting_max:
            found.append(
                f"no usable samples of the IMU (or the joints) for {self.coasting:.3f} s, "
                f"more than {config.coasting_max:.3f} s"
            )
        if t - self.command_stamp > config.controller_timeout:
            found.append(f"whole-body command older than {config.controller_timeout:.3f} s")
        if self.joint_fault:
            found.append(self.joint_fault)
        if self.drivers_damped:
            found.append("joint drivers fell back to damping")
        if self.status is SolveStatus.DAMPED:
            found.append("whole-body controller found no usable torques")
        if self.overruns >= config.overruns_max:
            found.append(f"whole-body controller overran its time budget in {self.overruns} ticks in a row")
        return found
