"""Reports of the other nodes at one instant, and the faults that the supervisor derives from them."""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, NamedTuple

from pydantic import Field
from pydantic.dataclasses import dataclass as pydantic_dataclass

from models.config import STRICT
from models.types import SolveStatus, Vector


@pydantic_dataclass(frozen=True, slots=True, config=STRICT)
class SupervisorConfig:
    """Schema of ``controllers/config/supervisor.yaml``: limits and vocabulary of the mode machine."""

    motions: tuple[str, ...]  #: Text commands that are planned as motions
    walking_motions: tuple[str, ...]  #: Motions with arms and head only, allowed while walking
    fall_tilt: Annotated[float, Field(gt=0, le=3.1)]  #: Base tilt that counts as a fall [rad]
    state_timeout: Annotated[float, Field(gt=0, le=2.0)]  #: Oldest usable state estimate [s]
    coasting_max: Annotated[float, Field(gt=0, le=1.0)]  #: Longest drop-out of the IMU or the joints [s]
    controller_timeout: Annotated[float, Field(gt=0, le=2.0)]  #: Oldest usable command [s]
    #: Longest silence of a node's diagnostics, in real and in plant time [s]
    heartbeat_timeout: Annotated[float, Field(gt=0.3, le=60)]
    overruns_max: Annotated[int, Field(gt=0, le=10000)]  #: Ticks in a row over budget that damp the robot [1]
    plan_timeout: Annotated[float, Field(gt=0, le=120)]  #: Longest wait for a motion to start [s]
    text_length_max: Annotated[int, Field(ge=16, le=4096)]  #: Longest accepted text command [characters]
    rate_tolerance: Annotated[float, Field(gt=0, lt=1)]  #: Accepted relative deviation of a rate [-]
    mass_tolerance: Annotated[float, Field(gt=0, lt=1)]  #: Accepted relative deviation of the mass [-]
    limit_margin: Annotated[float, Field(ge=0, le=1)]  #: Accepted excess over a joint limit [rad]
    filler_words: tuple[str, ...]  #: Words allowed besides a text command
    walk_on_velocity: bool  #: Whether a velocity starts a walk of a standing robot
    text_speed: Annotated[float, Field(ge=0, le=3)]  #: Speed of 'forward' and 'backward' [m/s]
    text_side_speed: Annotated[float, Field(ge=0, le=3)]  #: Speed of 'left' and 'right' [m/s]
    text_turn: Annotated[float, Field(ge=0, le=6)]  #: Turning speed of 'turn' [rad/s]
    text_spin: Annotated[float, Field(ge=0, le=6)]  #: Turning speed of 'spin' [rad/s]
    preflight_tilt: Annotated[float, Field(gt=0, le=1.6)]  #: Largest base tilt at arming [rad]


class Severity(IntEnum):
    """Effect of a fault; the most severe one wins."""

    HOLD = 1  # no velocity and no new motion; ends with its cause
    STAND = 2  # a walk comes to a standstill, a motion stops at once; none begins before the cause has gone
    DAMP = 3  # damped until ``reset_faults``; only an operator removes all torque


class Problem(NamedTuple):
    """One fault."""

    severity: Severity  # effect on the robot
    reason: str  # one sentence with the value that exceeds its limit, or the name of the source


def second_publisher(topic: str, who: str) -> str:
    """Sentence on a topic with a second publisher ``who``."""
    return f"'{topic}' has a second publisher: {who}; end it, then stand or call reset_faults"


def tilt(quaternion: Vector) -> float:
    """Angle between the z axis of the base and the vertical [rad]; orientation in W, xyzw (4,). NaN if not finite."""
    x, y, z, w = quaternion
    cosine = (z * z + w * w - x * x - y * y) / (x * x + y * y + z * z + w * w)
    return math.acos(min(max(cosine, -1.0), 1.0))


def fallen(config: SupervisorConfig, angle: float) -> bool:
    """Whether a base tilt [rad] counts as a fall; NaN (unknown) does."""
    return not angle < config.fall_tilt


@dataclass(frozen=True, slots=True)
class Health:
    """Newest report of each kind."""

    state_stamp: float  # of the newest state estimate [s]
    command_stamp: float  # of the newest whole-body command [s]
    tilt: float  # of the base from upright [rad]
    status: SolveStatus = SolveStatus.OPTIMAL  # solver status of the newest command
    drivers_damped: bool = False  # the joint drivers fell back to damping by themselves
    motion_active: bool = False  # the controller is following a motion
    overruns: int = 0  # consecutive ticks over the controller's time budget
    gait_active: bool = False  # the robot walks, or has not yet come to a standstill
    coasting: float = 0.0  # time without samples of the IMU or the joints [s]
    silent: tuple[str, ...] = ()  # nodes without recent diagnostics; the stamps cover the others
    intruders: tuple[str, ...] = ()  # one sentence per sensor topic with a second publisher
    hardware: tuple[str, ...] = ()  # faults reported by the monitors of a real robot, one sentence each
    joint_fault: str = ""  # fault of a motor or an encoder; empty if none

    def problems(self, config: SupervisorConfig, t: float) -> list[Problem]:
        """Problems at time t [s], most severe first; empty when healthy."""
        found = [Problem(Severity.DAMP, reason) for reason in self._damping(config, t)]
        found += [Problem(Severity.STAND, reason) for reason in self.intruders]
        found += [Problem(Severity.HOLD, reason) for reason in self.hardware]
        return found + [Problem(Severity.HOLD, f"node '{node}' sends no diagnostics") for node in self.silent]

    def _damping(self, config: SupervisorConfig, t: float) -> list[str]:
        """Reasons to damp the robot, the most informative first."""
        found = []
        if fallen(config, self.tilt):
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
