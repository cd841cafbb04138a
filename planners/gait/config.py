"""Schema of ``config/gait.yaml``, whose lengths are those of a reference leg; ``scaling.py`` fits it to a robot."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Fraction, NonNegative, Positive, Proportion, Share
from models.constants import GRAVITY

Axis = Literal["forward", "left", "turn"]  #: Component of a walking velocity


@dataclass(frozen=True, slots=True, config=STRICT)
class StrideConfig:
    """How the robot steps at one pace."""

    single: Positive  #: Nominal single support [s]
    double: Positive  #: Double support between two steps [s]
    crouch: NonNegative  #: Walking lowers the CoM below that of standing by this [m]
    clearance: Positive  #: Height of the sole at mid-swing [m]
    least_effort: Proportion  #: Part of the swing foot's path that is that of least acceleration, not jerk [-]
    toe_off: NonNegative  #: Rotation of the rear sole at lift-off, per distance behind the other one [rad/m]

    @property
    def period(self) -> float:
        """Time of a step [s]."""
        return self.single + self.double


@dataclass(frozen=True, slots=True, config=STRICT)
class PaceConfig:
    """How speed and disturbances change the gait, between ``slow`` and ``fast``; the law is in ``pace.py``."""

    forward: Positive  #: Speed along at which the gait is fast [m/s]
    lateral: Positive  #: Speed sideways at which it is [m/s]
    turn: Positive  #: Turning speed at which it is [rad/s]
    slow_share: Annotated[float, Field(ge=0.0, lt=1.0)]  #: Share of these speeds up to which it is slow [-]
    calm: NonNegative  #: Largest DCM error of an undisturbed walk [m]
    alarm: Positive  #: DCM error from which the gait is as fast as it can be [m]
    calm_time: Positive  #: Time constant with which it returns to the pace of its speed [s]
    friction_share: Positive  #: Share of the ground's coefficient of friction that the steps may need [-]
    slow: StrideConfig
    fast: StrideConfig

    def between(self, share: float, name: str) -> float:
        """A value of the stride at a share of the fast gait."""
        slow, fast = float(getattr(self.slow, name)), float(getattr(self.fast, name))
        return slow + share * (fast - slow)


@dataclass(frozen=True, slots=True, config=STRICT)
class RiseConfig:
    """Rise of the CoM over the stance leg; the law is that of ``StanceRise``."""

    share: NonNegative  #: Of the rise over a leg of fixed length [-]
    crest: Annotated[float, Field(ge=0.5, lt=1.0)]  #: Share of the single support at which the CoM is highest [-]
    acceleration: Positive  #: Largest vertical acceleration [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class TimingConfig:
    """When feet lift and land [s]."""

    single_min: Positive  #: Shortest single support
    single_urgent: Positive  #: Shortest single support when the DCM is far from its reference
    single_max: Positive  #: Longest single support
    start: Positive  #: First shift of the weight, from standing
    finish: Positive  #: Return of the weight to the middle after the last step
    adjust_period: Positive  #: Between two step adjustments
    landing_from: Share  #: Share of the single support after which a measured contact ends it [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class ReachConfig:
    """Where feet may be put."""

    width: Positive  #: Nominal lateral distance of the soles [m]
    width_min: Positive  #: Least lateral distance of the soles [m]
    width_max: Positive  #: Largest lateral distance of the soles [m]
    width_urgent: Positive  #: The same for an urgent step [m]
    cross: NonNegative  #: How far a crossing foot may land beyond the stance foot [m]
    cross_ahead: Positive  #: Least distance ahead of the stance foot, or behind it, of a foot that crosses [m]
    forward: Positive  #: Largest step ahead of the stance foot [m]
    backward: Positive  #: Largest step behind the stance foot [m]
    turn_out: Positive  #: Largest turn of a sole outwards from the stance sole [rad]
    turn_in: NonNegative  #: Largest turn of a sole inwards [rad]
    rise: Positive  #: Largest known height of a foothold above or below the stance foot [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class VelocityConfig:
    """Limits of the command."""

    forward: Positive  #: Largest velocity forward [m/s]
    backward: Positive  #: Largest velocity backward [m/s]
    lateral: Positive  #: Largest velocity to either side [m/s]
    turn: Positive  #: Largest turning speed [rad/s]
    acceleration: Positive  #: Of the linear velocities [m/s^2]
    turn_acceleration: Positive  #: Of the turning speed [rad/s^2]

    @property
    def ranges(self) -> dict[Axis, tuple[float, float]]:
        """Least and greatest velocity of each axis [m/s], [m/s], [rad/s]."""
        return {
            "forward": (-self.backward, self.forward),
            "left": (-self.lateral, self.lateral),
            "turn": (-self.turn, self.turn),
        }


@dataclass(frozen=True, slots=True, config=STRICT)
class SpeedConfig:
    """How steps are corrected that miss a velocity; see ``speed.py``."""

    gain: Share  #: Step size of the least mean squares [-]
    most: Share  #: Largest entry of the correction, and largest error over speed that is learned from [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class SwingConfig:
    """Swing foot."""

    apex: Share  #: Share of the swing at which it is reached [-]
    landing_velocity: NonNegative  #: Downward speed of the sole at the planned touchdown [m/s]
    late_velocity: Positive  #: Downward speed of a foot that is late [m/s]
    late_time: Positive  #: Time constant of a late foot's way to its target sideways [s]
    depth_max: Positive  #: How far below its target a late foot is lowered [m]
    speed_max: Positive  #: Largest mean horizontal speed by a step adjustment [m/s]
    acceleration_max: Positive  #: Largest acceleration along each axis that a step adjustment counts on [m/s^2]
    #: The same as a share of what the limits of the joints give the foot; of each joint's in a nominal step [-]
    speed_share: Positive
    urgent_lead: NonNegative  #: By how much earlier an urgent step aims to touch down [s]
    freeze: Positive  #: Time before touchdown at which the target is frozen [s]
    edge: Positive  #: Least distance of the sole on a known foothold from an edge on its way there [m]
    edge_clearance: Positive  #: Height of the sole over such an edge: on its way up the toe hangs [m]
    lift_acceleration: Positive  #: Largest vertical acceleration of a nominal swing to a known height [m/s^2]
    rise_step: NonNegative  #: Largest change between landings of the expected landing height [m]
    rise_max: NonNegative  #: Largest expected height over the stance sole's plane [m]
    drift_share: Share  #: Of the error of a known height at a landing, what is taken for drift of the estimate [-]
    tilt_time: Positive  #: Time constant of its turn to the slope expected at landing [s]
    trip_lag: Positive  #: Distance from its reference from which a foot may have tripped [m]
    trip_force: Share  #: Least force away from its reference with which it has, share of the weight [-]
    trip_time: Positive  #: Time for which a foot that tripped only rises [s]
    trip_back: NonNegative  #: Distance by which it is drawn back from where it was caught [m]
    trip_landing: Positive  #: Least time from the end of that rise to the touchdown [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class AdjustmentConfig:
    """Step adjustment."""

    position: Positive  #: Weight of the foothold's distance from the nominal one [1/m^2]
    time: Positive  #: Weight of ``exp(omega T)``'s distance from the nominal one, of a walk that goes on [-]
    time_ending: Positive  #: The same of one that comes to an end, as when a standing robot catches itself [-]
    offset: Positive  #: Weight of the DCM offset's distance from the nominal one [1/m^2]
    cop: Positive  #: Weight of the CoP offset over the rest of the step [1/m^2]
    cop_share: NonNegative  #: Share of the sole that the CoP offset may use [-]
    urgent: Positive  #: Distance of the DCM from its reference at which steps are as quick as they can be [m]
    capture: NonNegative  #: Weight of how far the next step would miss the DCM, by which regions are ranked [1/m^2]
    switch: NonNegative  #: Advantage of the objective for which a foot under way turns to another region [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class RouteConfig:
    """Footsteps to a pose, and lists of footsteps."""

    pace: Share  #: Share of the fast gait with which they are taken [-]
    forward: Positive  #: Speed along [m/s]
    lateral: Positive  #: Speed sideways [m/s]
    turn: Positive  #: Turning speed [rad/s]
    position_tolerance: Positive  #: Position error at the goal [m]
    turn_tolerance: Positive  #: Heading error at the goal [rad]
    offset_max: Positive  #: Landing error beyond which the route to the goal is planned anew [m]
    range: Positive  #: Farthest goal [m]
    steps_max: Annotated[int, Field(ge=1, le=1000)]  #: Most footsteps in a route
    #: Footsteps more than twice those planned after which a goal is given up, when feet still land off their places
    steps_more: Annotated[int, Field(ge=0, le=1000)]


@dataclass(frozen=True, slots=True, config=STRICT)
class GroundConfig:
    """Inclination of the ground, measured by the soles."""

    #: Time constant with which the tilt of a sole that has just landed is taken as the ground's [s]
    settle_time: Positive
    anchor_time: Positive  #: The same of a sole that bears: one that tips is drawn back to where it stood [s]
    settled: Positive  #: Time in single support from which the tilt of the stance sole is the ground's [s]
    #: Soles, with the one that stands, over which the slope expected at the next landing is the median
    slope_steps: Annotated[int, Field(ge=1, le=9)]
    slope_max: Positive  #: Steepest expected slope [-]
    level: Positive  #: Of known ground, up to which difference of height the feet go ahead in turn [m]
    #: Height by which a landing may miss what is expected, before the ground counts as rough [m]
    even: NonNegative
    rough_max: NonNegative  #: Largest height by which swing feet are lifted higher on rough ground [m]
    rough_steps: Positive  #: Steps in which that fades [-]
    rough_trip: NonNegative  #: Height of rough ground over which a foot has tripped [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class FootingConfig:
    """A sole that turns over an edge."""

    load: Share  #: Least share of the weight on a sole for its rotation to count [-]
    turning: Positive  #: Angular velocity about its length or width above which it turns [rad/s]
    turned: Positive  #: Least recent rotation of a sole that turns over an edge [rad]
    forget_time: Positive  #: Time constant of the recent rotation [s]
    edge: Positive  #: Largest motion of its CoP meanwhile: a sole that rolls as it lands has no edge under it [m]
    still: Positive  #: Angular velocity below which it lies still [rad/s]
    rest: Positive  #: Time at rest after which its orientation counts [s]
    fallen: Positive  #: Least rotation of a sole at rest that has found ground on the other side of the edge [rad]
    regain: Positive  #: Speed at which the area of a sole at rest that has turned less grows again [m/s]
    grain: Positive  #: Resolution of the areas: each change costs the QP a new wrench cone [m]
    rim: Positive  #: Distance of the CoP from the rim up to which a sole may have tipped over it [m]
    tipped: Positive  #: Angle over the rim from which a sole bears on it alone; half of it ends that [rad]
    lie_angle: NonNegative  #: Angle by which a sole on its rim is turned towards the ground, from where it is [rad]
    lie_time: Positive  #: Time constant with which a sole at rest is taken to lie on the ground [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class AnkleConfig:
    """An ankle of the stance leg that comes to a limit in an urgent step: its sole turns over an edge."""

    stop_time: NonNegative  #: The sole is planned to turn this long before the joint is at its limit [s]
    stop_margin: NonNegative  #: Of the limit, as the joint margin of the whole-body QP [rad]
    rim: Positive  #: Largest distance of the CoP from that edge [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class LiftConfig:
    """A robot that is lifted off the floor."""

    float_time: Positive  #: Without load on both feet, the posture is held and the gait waits after this time [s]
    up_time: Positive  #: The robot counts as lifted and the walk ends after this time [s]
    level_time: Positive  #: Duration of the return to the standing posture, in which it can be put down [s]
    down_time: Positive  #: With load on both feet, it counts as put down after this time [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class GaitConfig:
    """The gait."""

    leg: Positive  #: Hip height above the sole of the robot that the lengths are written for [m]
    foot: tuple[Positive, Positive]  #: Length and width of the shape of its foot [m]
    zmp: Share  #: ZMP point of single support, from under the ankle (0) to the middle of the sole (1) [-]
    #: Share of a joint's torque limit that a nominal step may take, by the root of its mean square
    torque_share: Fraction
    height_rate: Positive  #: Fastest rise of the CoM height reference [m/s]
    height_acceleration: Positive  #: Largest of the CoM height reference: well below gravity, feet bear load [m/s^2]
    #: ... in an urgent step, in which a foot that bears alone bears what this leaves of the weight [m/s^2]
    height_acceleration_urgent: Annotated[float, Field(gt=0.0, lt=GRAVITY)]
    drop_rate: Positive  #: Fastest descent of the CoM height reference [m/s]
    drop_rate_urgent: Positive  #: ... in an urgent step, whose legs have to reach far in little time [m/s]
    preview: Annotated[int, Field(ge=1, le=12)]  #: Steps that the DCM recursion looks ahead
    settle_dcm: Positive  #: DCM distance from the middle at which a finished walk counts as standing [m]
    settle_speed: Positive  #: Speed of the CoM below which it does, too [m/s]
    settle_time: NonNegative  #: For this long [s]
    #: Share of the way from the middle to the edge of both soles at which a standing robot steps [-]
    step_share: Share
    #: Share of the way between the feet at which the body is when the foot of an urgent step lands [-]
    lean_urgent: Share
    push_horizon: NonNegative  #: Time for which a push that makes a standing robot step is expected to go on [s]
    push_filter: Positive  #: Time constant of the DCM's measured rate [s]
    #: Distance of a sole from its place in the nominal stance beyond which the robot steps back after a recovery step
    #: [m]
    astride: Positive
    astride_max: Positive  #: Distance beyond which it does not come to rest [m]; greater than ``astride``
    anchor_time: Positive  #: Time constant with which planted footholds follow the soles that bear load [s]
    anchor_load: Share  #: Share of the weight that a foot must bear for its foothold to follow it [-]
    pace: PaceConfig
    rise: RiseConfig
    timing: TimingConfig
    reach: ReachConfig
    velocity: VelocityConfig
    speed: SpeedConfig
    swing: SwingConfig
    adjustment: AdjustmentConfig
    route: RouteConfig
    ground: GroundConfig
    footing: FootingConfig
    ankle: AnkleConfig
    lift: LiftConfig

    @property
    def period(self) -> float:
        """Nominal time of a step of a route [s]."""
        return self.pace.between(self.route.pace, "single") + self.pace.between(self.route.pace, "double")

    def __post_init__(self) -> None:
        timing, reach = self.timing, self.reach
        for stride in (self.pace.slow, self.pace.fast):
            if not timing.single_min <= stride.single <= timing.single_max:
                raise ValueError("timing: single_min <= single of a pace <= single_max does not hold")
        if self.pace.alarm <= self.pace.calm:
            raise ValueError("pace.alarm, a DCM error, must be greater than calm")
        if not reach.width_min <= reach.width <= reach.width_max:
            raise ValueError("reach: width_min <= width <= width_max does not hold")
        if reach.width_urgent < reach.width_max or timing.single_urgent > timing.single_min:
            raise ValueError("the limits of an urgent step may not be narrower than those of other steps")
        if self.astride_max <= self.astride:
            raise ValueError("astride_max, the widest stance to come to rest in, must be greater than astride")
