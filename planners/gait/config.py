"""Schema of ``config/gait.yaml``: lengths are those of the reference leg; ``scaling.py`` scales them with the leg."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT

Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Share = Annotated[float, Field(gt=0.0, le=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class TimingConfig:
    """When feet lift and land [s].

    Attributes:
        single: Nominal single support.
        single_min: Shortest single support.
        single_urgent: Shortest single support when the DCM is far from its reference.
        single_max: Longest single support.
        double: Double support between two steps.
        start: First shift of the weight, from standing.
        finish: Return of the weight to the middle after the last step.
        adjust_period: Between two step adjustments.
        landing_from: Share of the single support after which a measured contact ends it [-].
    """

    single: Positive
    single_min: Positive
    single_urgent: Positive
    single_max: Positive
    double: Positive
    start: Positive
    finish: Positive
    adjust_period: Positive
    landing_from: Share


@dataclass(frozen=True, slots=True, config=STRICT)
class ReachConfig:
    """Where feet may be put.

    Attributes:
        width: Nominal lateral distance of the soles [m].
        width_min: Least lateral distance of the soles [m].
        width_max: Largest lateral distance of the soles [m].
        width_urgent: The same for an urgent step [m].
        forward: Largest step ahead of the stance foot [m].
        backward: Largest step behind the stance foot [m].
        turn_out: Largest turn of a sole outwards from the stance sole [rad].
        turn_in: Largest turn of a sole inwards [rad].
    """

    width: Positive
    width_min: Positive
    width_max: Positive
    width_urgent: Positive
    forward: Positive
    backward: Positive
    turn_out: Positive
    turn_in: NonNegative


@dataclass(frozen=True, slots=True, config=STRICT)
class VelocityConfig:
    """Limits of the command.

    Attributes:
        forward: Largest velocity forward [m/s].
        backward: Largest velocity backward [m/s].
        lateral: Largest velocity to either side [m/s].
        turn: Largest turning speed [rad/s].
        acceleration: Of the linear velocities [m/s^2].
        turn_acceleration: Of the turning speed [rad/s^2].
    """

    forward: Positive
    backward: Positive
    lateral: Positive
    turn: Positive
    acceleration: Positive
    turn_acceleration: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class SwingConfig:
    """Swing foot.

    Attributes:
        clearance: Height of the sole at mid-swing [m].
        apex: Share of the swing at which it is reached [-].
        landing_velocity: Downward speed of the sole at the planned touchdown [m/s].
        late_velocity: Downward speed of a foot that is late [m/s].
        late_time: Time constant with which a late foot follows its target sideways [s].
        depth_max: How far below its target a late foot is lowered [m].
        speed_max: Largest mean horizontal speed that a step adjustment may ask of the foot [m/s].
        speed_share: The same as a share of what the limits of the joints give the foot [-].
        urgent_lead: Time by which the foot of an urgent step aims at an earlier touchdown [s].
        freeze: Time before touchdown at which the target is frozen [s].
        rise_step: Largest change from one landing to the next of the height that a foot is expected to land at [m].
        rise_max: Largest expected height over the stance foot's plane, up or down [m].
        tilt_time: Time constant with which the foot turns to the slope expected at its landing [s].
        trip_lag: Distance behind its reference at which a foot may have been caught by something [m].
        trip_speed: Share of its reference's speed below which it then has been [-].
        trip_filter: Time constant of the measured speed [s].
        trip_time: How long a caught foot only rises [s].
    """

    clearance: Positive
    apex: Share
    landing_velocity: NonNegative
    late_velocity: Positive
    late_time: Positive
    depth_max: Positive
    speed_max: Positive
    speed_share: Positive
    urgent_lead: NonNegative
    freeze: Positive
    rise_step: NonNegative
    rise_max: NonNegative
    tilt_time: Positive
    trip_lag: Positive
    trip_speed: Share
    trip_filter: Positive
    trip_time: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class AdjustmentConfig:
    """Step adjustment.

    Attributes:
        position: Weight of the foothold's distance from the nominal one [1/m^2].
        time: Weight of ``exp(omega T)``'s distance from the nominal one, of a walk that goes on [-].
        time_ending: The same of one that comes to an end, as when a standing robot catches itself [-].
        offset: Weight of the DCM offset's distance from the nominal one [1/m^2].
        cop: Weight of the CoP offset over the rest of the step [1/m^2].
        cop_share: Share of the sole that the CoP offset may use [-].
        urgent: Distance of the DCM from its reference at which steps are as quick as they can be [m].
    """

    position: Positive
    time: Positive
    time_ending: Positive
    offset: Positive
    cop: Positive
    cop_share: NonNegative
    urgent: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class RouteConfig:
    """Footsteps to a pose, and lists of footsteps.

    Attributes:
        forward: Speed along [m/s].
        lateral: Speed sideways [m/s].
        turn: Turning speed [rad/s].
        position_tolerance: Distance from its goal at which a sole has reached it [m].
        turn_tolerance: Heading error at which it has [rad].
        offset_max: A foot that lands farther from its planned place has the way to the goal planned anew [m].
        range: Farthest goal [m].
        steps_max: Most footsteps in a route.
    """

    forward: Positive
    lateral: Positive
    turn: Positive
    position_tolerance: Positive
    turn_tolerance: Positive
    offset_max: Positive
    range: Positive
    steps_max: Annotated[int, Field(ge=1, le=1000)]


@dataclass(frozen=True, slots=True, config=STRICT)
class GroundConfig:
    """Inclination of the ground, felt through the soles.

    Attributes:
        settle_time: Time constant with which the tilt of a sole that has just landed is taken as the ground's [s].
        anchor_time: The same of a sole that bears: one that tips is drawn back to where it stood [s].
        slope_steps: Steps over whose soles the slope expected at the next landing is the median.
        slope_max: Steepest slope believed [-].
    """

    settle_time: Positive
    anchor_time: Positive
    slope_steps: Annotated[int, Field(ge=1, le=9)]
    slope_max: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class FootingConfig:
    """A sole that turns over an edge.

    Attributes:
        load: Share of the weight that a sole bears at least for its turning to mean anything [-].
        turning: Angular velocity about its length or width above which it turns [rad/s].
        turned: Angle by which it has turned at least, of late [rad].
        forget_time: Time constant of "of late" [s].
        edge: Way by which its CoP may move meanwhile: a sole that rolls as it lands has no edge under it [m].
        still: Angular velocity below which it lies still [rad/s].
        rest: Time for which it has to lie still before how it lies counts [s].
        fallen: Angle by which a sole that then lies still has turned at least to have found ground there [rad].
        regain: Speed at which one that has turned less is then believed in again [m/s].
        strip: Width that is left at least of what bears [m].
        grain: Steps in which the areas are told: each change costs the QP a new wrench cone [m].
    """

    load: Share
    turning: Positive
    turned: Positive
    forget_time: Positive
    edge: Positive
    still: Positive
    rest: Positive
    fallen: Positive
    regain: Positive
    strip: Positive
    grain: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class LiftConfig:
    """A robot that is lifted off the floor.

    Attributes:
        float_time: Both feet without load for so long: it is held as it is, its gait waits [s].
        up_time: For so long: it has been lifted, the walk is over [s].
        level_time: It then takes so long to return to the standing posture, for being put down [s].
        down_time: Both feet loaded for so long: it has been put down [s].
    """

    float_time: Positive
    up_time: Positive
    level_time: Positive
    down_time: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class GaitConfig:
    """The gait.

    Attributes:
        leg: Hip height above the sole of the robot that the lengths are written for [m].
        crouch: Walking lowers the CoM below that of standing by this [m].
        height_rate: Fastest rise of the wanted CoM height [m/s].
        drop_rate: Fastest descent of it [m/s].
        preview: Steps that the DCM recursion looks ahead.
        settle_dcm: DCM distance from the middle at which a finished walk counts as standing [m].
        settle_time: For this long [s].
        step_share: Share of the way from the middle to the edge of both soles at which a standing robot steps [-].
        lean_urgent: Share of the way between the feet at which the body is when the foot of an urgent step lands [-].
        astride: Distance of a sole from where it stands beside the other one at which a robot that stands again after
            it has caught itself steps back [m].
        astride_max: Distance at which it does not come to rest [m]; greater than ``astride``.
        anchor_time: Time constant with which planted footholds follow the soles that bear load [s].
        anchor_load: Share of the weight that a foot must bear for its foothold to follow it [-].
        timing, reach, velocity, swing, adjustment, route, ground, footing, lift: Parts.
    """

    leg: Positive
    crouch: NonNegative
    height_rate: Positive
    drop_rate: Positive
    preview: Annotated[int, Field(ge=1, le=12)]
    settle_dcm: Positive
    settle_time: NonNegative
    step_share: Share
    lean_urgent: Share
    astride: Positive
    astride_max: Positive
    anchor_time: Positive
    anchor_load: Share
    timing: TimingConfig
    reach: ReachConfig
    velocity: VelocityConfig
    swing: SwingConfig
    adjustment: AdjustmentConfig
    route: RouteConfig
    ground: GroundConfig
    footing: FootingConfig
    lift: LiftConfig

    @property
    def period(self) -> float:
        """Nominal time of a step [s]."""
        return self.timing.single + self.timing.double

    def __post_init__(self) -> None:
        timing, reach = self.timing, self.reach
        if not timing.single_min <= timing.single <= timing.single_max:
            raise ValueError("timing: single_min <= single <= single_max does not hold")
        if not reach.width_min <= reach.width <= reach.width_max:
            raise ValueError("reach: width_min <= width <= width_max does not hold")
        if reach.width_urgent < reach.width_max or timing.single_urgent > timing.single_min:
            raise ValueError("an urgent step may not be held to narrower limits than any other")
        if self.astride_max <= self.astride:
            raise ValueError("a stance that is to be left, astride, must be one to come to rest in, astride_max")
