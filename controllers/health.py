"""What the supervisor needs to know of the other nodes at one instant, and what is wrong with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from controllers.supervisor_config import SupervisorConfig
from models.types import SolveStatus, Vector


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

    def problems(self, config: SupervisorConfig, t: float) -> list[str]:
        """Faults that end standing, most telling first; empty when healthy.

        Args:
            config: Limits.
            t: Stamp of now [s].

        Returns:
            One sentence each, with the figure that broke the limit.
        """
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
        if self.drivers_damped:
            found.append("joint drivers fell back to damping")
        if self.status is SolveStatus.DAMPED:
            found.append("whole-body controller found no usable torques")
        if self.overruns >= config.overruns_max:
            found.append(f"whole-body controller overran its time budget in {self.overruns} ticks in a row")
        return found
