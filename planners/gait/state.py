"""State of a gait, its coming steps, and the margin for coming to rest with one step."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from msgspec import Struct, structs

from models.constants import COM_HEIGHT_MIN, GRAVITY
from models.types import Reference, Vector
from planners.gait.commands import NO_COMMAND, CommandState
from planners.gait.config import GaitConfig
from planners.gait.contact import AirborneState, Soles, SoleState
from planners.gait.dcm import DcmState
from planners.gait.footing import FootingState
from planners.gait.footsteps import LEFT, Foothold, limits_of, preview_footholds
from planners.gait.measurement import Measurement
from planners.gait.pace import Pace
from planners.gait.regions import Region
from planners.gait.swing import AT_REST, SwingState, Via

TIMES = 5  #: Number of touchdown times in the search of the capturability margin


class GaitPhase(Enum):
    """Phase of the gait."""

    STAND = "stand"
    START = "start"  #: On both feet; the weight moves to the first stance foot
    SINGLE = "single"
    DOUBLE = "double"  #: On both feet; the weight moves to the foot that has just landed
    FINISH = "finish"  #: On both feet; the weight returns to the middle
    LIFTED = "lifted"  #: Off the floor: the posture is held

    @property
    def stepping(self) -> bool:
        """Whether a foot is in the air or about to lift."""
        return self in (GaitPhase.START, GaitPhase.SINGLE, GaitPhase.DOUBLE)

    @property
    def airborne(self) -> bool:
        """Whether a foot has left the floor since the robot last stood."""
        return self not in (GaitPhase.STAND, GaitPhase.START)

    @property
    def resting(self) -> bool:
        """Whether the weight is between both feet, or returns there."""
        return self in (GaitPhase.STAND, GaitPhase.FINISH)


class Rest(Struct, frozen=True):
    """Stance of a robot that takes no steps."""

    dcm: Vector  #: DCM at which the robot comes to rest, in W (2,) [m]
    velocity: Vector  #: CoM velocity there, in W (2,) [m/s]
    height: float  #: CoM height above the soles [m]
    walk: bool = True  #: The gait follows its commands
    step: bool = True  #: The robot may step to keep its balance
    standing: Reference | None = None  #: Reference that the gait returns in phase ``STAND``; None during a blend to it


class StepState(Struct, frozen=True):
    """Present or last single support."""

    time: float  #: Time of the planned touchdown since lift-off [s]
    double: float  #: Duration of the double support after the last touchdown [s]
    touchdown: Vector  #: DCM reference at the touchdown, in W (2,) [m]
    liftoff: Foothold = Foothold(0.0, 0.0, 0.0)  #: Foothold at lift-off of the swing foot
    next_adjustment: float = 0.0  #: Time of the next step adjustment since lift-off [s]
    urgent: bool = False  #: A large DCM error has made the step as quick as possible
    region: Region = Region.OWN  #: Region of the foothold
    via: Via | None = None  #: Corner that the swing foot passes
    unsolved: int = 0  #: Number of step adjustments without a solution, which use the nominal step

    def shifted(self, x: float, y: float) -> StepState:
        """Step shifted in W [m]."""
        liftoff, touchdown = self.liftoff.shifted(x, y), self.touchdown + np.array((x, y))
        via = None if self.via is None else self.via.shifted(x, y)
        return structs.replace(self, liftoff=liftoff, touchdown=touchdown, via=via)


class BodyState(Struct, frozen=True):
    """Reference of the body."""

    height: float  #: CoM height above the ground [m]
    #: Height of the ground under the CoM [m], rate-limited relative to the expected slope; None before the first tick
    ground: float | None = None
    rate: float = 0.0  #: Rate of ``height`` [m/s]
    acceleration: float = 0.0  #: Acceleration of ``height`` [m/s^2]
    climb: float = 0.0  #: Rate of the ground under the CoM [m/s]
    #: Additional rise over the stance leg, its rate and acceleration [m, m/s, m/s^2]
    rise: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: Additional known height of the ground under the CoM, its rate and acceleration [m, m/s, m/s^2]
    relief: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(slots=True)
class GaitState:
    """State of a gait between ticks. Its parts are immutable values, so a copy shares them."""

    measured: Measurement
    dcm_rate: Vector  #: Rate of the measured DCM, low-passed (2,) [m/s]
    soles: SoleState
    footing: FootingState
    step: StepState
    dcm: DcmState
    body: BodyState
    airborne: AirborneState
    pace: Pace
    urgency: float = 0.0  #: Share of the fast gait that disturbances require [-]
    command: CommandState = NO_COMMAND
    swing: SwingState = AT_REST
    phase: GaitPhase = GaitPhase.STAND
    stance: int = 1  #: Present or next stance foot (0 left, 1 right)
    steps: int = 0  #: Number of touchdowns
    elapsed: float = 0.0  #: Time in this phase [s]
    settled: float = 0.0  #: Time at rest in phase ``STAND`` [s]
    early: float = 0.0  #: Time by which the last touchdown was early [s]
    recovering: bool = False  #: The present steps began with a recovery step of a standing robot
    rest: Rest | None = None  #: Stance while no steps are taken; over the middle of the soles when None

    @property
    def omega(self) -> float:
        """Natural frequency of the pendulum [1/s]."""
        return math.sqrt(GRAVITY / max(self.body.height, COM_HEIGHT_MIN))

    @property
    def single(self) -> float:
        """Nominal single support of the present or next step [s]."""
        return max(self.pace.single, self.command.route.swing)

    @property
    def dcm_error(self) -> float:
        """Distance of the DCM from its reference [m]."""
        error = self.measured.dcm(self.omega) - self.dcm.dcm
        return math.hypot(*error.tolist())

    def copy(self) -> GaitState:
        """Copy of the state, for a checkpoint."""
        return copy.copy(self)


@dataclass(frozen=True, slots=True)
class GaitView:
    """State of a gait and its measured DCM, for observers."""

    state: GaitState
    dcm: Vector  #: Measured DCM in W (2,) [m]
    soles: Soles

    @property
    def swinging(self) -> bool:
        """Whether a foot is in the air."""
        return self.state.phase is GaitPhase.SINGLE


def coming_steps(view: GaitView, config: GaitConfig) -> list[Foothold]:
    """Next footholds of alternating feet; the first is the adjusted one of the foot in the air. Empty at rest."""
    gait, holds, command = view.state, view.state.soles.holds, view.state.command
    if gait.phase.resting:
        return []
    first, foot = holds[gait.stance], 1 - gait.stance
    taken, left = [], command.steps_left
    if view.swinging:
        taken = [holds[foot]]
        first, foot = taken[0], gait.stance
        left = None if left is None else left - 1
    if left is not None and left <= 0:
        return taken
    if command.route.left:
        level = gait.soles.levels[gait.stance]
        ahead = command.route.ahead(holds[gait.stance], config.preview, limits_of(config.reach), level)
        return [*taken, *ahead[len(taken) :]]
    count, period = max(config.preview - len(taken), 1), gait.pace.period
    return taken + preview_footholds(first, foot, command.asked, period, config.reach, count, left)


def capture_margin(view: GaitView, config: GaitConfig) -> float:
    r"""Distance of the DCM inside the region from which one step brings the robot to rest; negative outside [m].

    With the CoP anywhere in the stance sole (half size h) until a touchdown after t, the DCM ends within
    ``exp(omega t) xi -+ (exp(omega t) - 1) h``. One step suffices if this interval intersects the reachable footholds,
    extended by the half size h' of the landing sole. Along each axis of the stance sole:

    .. math:: e^{\omega t} \xi \in [r_{min} - h', r_{max} + h'] \pm (e^{\omega t} - 1) h

    The margin is the largest one over ``TIMES`` times from the soonest to the latest one. On both feet, it includes the
    margin to the hull of the soles, inside which no step is needed.

    References:
        Koolen et al.: Capturability-based analysis and control of legged locomotion, part 1, IJRR 2012, section 5.
    """
    gait = view.state
    if view.swinging:
        return _one_step(view, config, gait.stance, gait.elapsed)
    places, half = view.soles.standing_support(gait.soles.holds, view.dcm)
    stances = (0, 1) if gait.phase.resting else (gait.stance,)
    steps = [_one_step(view, config, stance, 0.0) for stance in stances]
    return max(min(extent - place for place, extent in zip(places, half, strict=True)), *steps)


def _one_step(view: GaitView, config: GaitConfig, stance: int, elapsed: float) -> float:
    """Margin on one foot [m], ``elapsed`` [s] after the lift-off of the other one."""
    timing, soles, reach, foot = config.timing, view.soles, config.reach, 1 - stance
    soonest = max(timing.single_min, elapsed + config.swing.freeze)
    times = np.linspace(soonest, max(timing.single_max, soonest), TIMES) - elapsed
    growth = np.exp(view.state.omega * times)[:, None]  # (TIMES, 1)
    width = (reach.width_min, reach.width_max) if foot == LEFT else (-reach.width_max, -reach.width_min)
    shift = soles.centres[foot] - soles.centres[stance]
    more = soles.half[foot] + (growth - 1.0) * soles.half[stance]  # (TIMES, 2)
    lower = (np.array([-reach.backward, width[0]]) + shift - more) / growth
    upper = (np.array([reach.forward, width[1]]) + shift + more) / growth
    place = np.array(view.state.soles.holds[stance].relative(*view.dcm)) - soles.centres[stance]
    return float(np.minimum(place - lower, upper - place).min(axis=1).max())
