"""Schema of ``config/gait.yaml``. Its lengths are for a reference leg; ``scaling.py`` scales them to a robot."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Fraction, NonNegative, Positive, Proportion, Share
from models.constants import GRAVITY

Axis = Literal["forward", "left", "turn"]  #: Component of a walking velocity


@dataclass(frozen=True, slots=True, config=STRICT)
class StrideConfig:
    """Steps at one pace."""

    single: Positive  #: Nominal single support [s]
    double: Positive  #: Double support between two steps [s]
    crouch: NonNegative  #: Height of the CoM in standing less its height in walking [m]
    clearance: Positive  #: Height of the sole at mid-swing [m]
    least_effort: Proportion  #: Share of the minimum-acceleration path in the swing path; the rest is minimum jerk [-]

    @property
    def period(self) -> float:
        """Time of a step [s]."""
        return self.single + self.double


@dataclass(frozen=True, slots=True, config=STRICT)
class PaceConfig:
    """Gait between ``slow`` and ``fast`` as a function of speed and disturbances; see ``pace.py`` for the law."""

    forward: Positive  #: Longitudinal speed at which the gait is fast [m/s]
    lateral: Positive  #: Lateral speed at which the gait is fast [m/s]
    turn: Positive  #: Turning speed at which the gait is fast [rad/s]
    slow_share: Annotated[float, Field(ge=0.0, lt=1.0)]  #: Share of these speeds up to which the gait is slow [-]
    calm: NonNegative  #: Largest DCM error of an undisturbed walk [m]
    alarm: Positive  #: DCM error above which the gait is fast at any speed [m]
    calm_time: Positive  #: Time constant of the return to the pace of the speed [s]
    friction_share: Positive  #: Share of the ground's coefficient of friction that the steps may use [-]
    slow: StrideConfig
    fast: StrideConfig

    def between(self, share: float, name: str) -> float:
        """Value of a stride parameter at a share of the fast gait."""
        slow, fast = float(getattr(self.slow, name)), float(getattr(self.fast, name))
        return slow + share * (fast - slow)


@dataclass(frozen=True, slots=True, config=STRICT)
class RiseConfig:
    """Rise of the CoM over the stance leg; see ``ReferenceBuilder`` for the law."""

    share: NonNegative  #: Share of the rise over a leg of fixed length [-]
    crest: Annotated[float, Field(ge=0.5, lt=1.0)]  #: Share of the single support at which the CoM is highest [-]
    acceleration: Positive  #: Largest vertical acceleration [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class TimingConfig:
    """Times of lift-off and touchdown."""

    single_min: Positive  #: Shortest single support [s]
    single_urgent: Positive  #: Shortest single support in an urgent step [s]
    single_max: Positive  #: Longest single support [s]
    start: Positive  #: Duration of the first shift of the weight, from standing [s]
    finish: Positive  #: Duration of the return of the weight to the middle after the last step [s]
    adjust_period: Positive  #: Period of the step adjustments [s]
    landing_from: Share  #: Share of the single support after which a measured contact ends it [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class ReachConfig:
    """Bounds of a foothold relative to the stance foot."""

    width: Positive  #: Nominal lateral distance of the soles [m]
    width_min: Positive  #: Least lateral distance of the soles [m]
    width_max: Positive  #: Largest lateral distance of the soles [m]
    width_urgent: Positive  #: Largest lateral distance of the soles in an urgent step [m]
    cross: NonNegative  #: Largest lateral distance of a crossing foot beyond the stance foot [m]
    cross_ahead: Positive  #: Least distance of a crossing foot ahead of or behind the stance foot [m]
    forward: Positive  #: Largest step ahead of the stance foot [m]
    backward: Positive  #: Largest step behind the stance foot [m]
    turn_out: Positive  #: Largest turn of a sole outwards from the stance sole [rad]
    turn_in: NonNegative  #: Largest turn of a sole inwards from the stance sole [rad]
    rise: Positive  #: Largest known height of a foothold above or below the stance foot [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class VelocityConfig:
    """Limits of the commanded velocity."""

    forward: Positive  #: Largest velocity forward [m/s]
    backward: Positive  #: Largest velocity backward [m/s]
    lateral: Positive  #: Largest velocity to either side [m/s]
    turn: Positive  #: Largest turning speed [rad/s]
    acceleration: Positive  #: Largest rate of the linear velocities [m/s^2]
    turn_acceleration: Positive  #: Largest rate of the turning speed [rad/s^2]

    @property
    def ranges(self) -> dict[Axis, tuple[float, float]]:
        """Lower and upper bound of the velocity of each axis [m/s], [m/s], [rad/s]."""
        return {
            "forward": (-self.backward, self.forward),
            "left": (-self.lateral, self.lateral),
            "turn": (-self.turn, self.turn),
        }


@dataclass(frozen=True, slots=True, config=STRICT)
class SpeedConfig:
    """Correction of steps that do not reach the commanded velocity; see ``speed.py``."""

    gain: Share  #: Step size of the least mean squares [-]
    most: Share  #: Bound of the entries of the correction, and of the error relative to the speed [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class SwingConfig:
    """Swing foot."""

    apex: Share  #: Time of the apex, as a share of the swing [-]
    landing_velocity: NonNegative  #: Downward speed of the sole at the planned touchdown [m/s]
    late_velocity: Positive  #: Downward speed of a late foot [m/s]
    late_time: Positive  #: Time constant of the horizontal motion of a late foot to its target [s]
    depth_max: Positive  #: Largest distance of a late foot below its target [m]
    speed_max: Positive  #: Largest mean horizontal speed that a step adjustment assumes [m/s]
    acceleration_max: Positive  #: Largest acceleration along each axis that a step adjustment assumes [m/s^2]
    #: Largest share of the foot speed at the joints' limits, and of each joint's limit in a nominal step [-]
    speed_share: Positive
    urgent_lead: NonNegative  #: Time from the end of the swing reference to the touchdown of an urgent step [s]
    freeze: Positive  #: Time before touchdown at which the target is frozen [s]
    edge: Positive  #: Least distance of the sole on a known foothold from an edge that it passes [m]
    edge_clearance: Positive  #: Clearance of the sole over such an edge, since the toe hangs down in the ascent [m]
    lift_acceleration: Positive  #: Largest vertical acceleration of a nominal swing to a known height [m/s^2]
    drift_share: Share  #: Share of the error of a known landing height that is attributed to drift of the estimate [-]
    tilt_time: Positive  #: Time constant of the rotation of the sole to the slope expected at landing [s]
    trip_lag: Positive  #: Least distance of a foot that tripped from its reference [m]
    trip_force: Share  #: Least force on a foot that tripped, away from its reference, as a share of the weight [-]
    trip_time: Positive  #: Time for which a foot that tripped only rises [s]
    trip_back: NonNegative  #: Distance by which a foot that tripped is moved back [m]
    trip_landing: Positive  #: Least time from the end of that rise to the touchdown [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class AdjustmentConfig:
    """Step adjustment."""

    position: Positive  #: Weight of the deviation from the nominal foothold [1/m^2]
    time: Positive  #: Weight of the deviation from the nominal ``exp(omega T)``, in a walk that continues [-]
    time_ending: Positive  #: The same in a walk that ends, for example a recovery step of a standing robot [-]
    offset: Positive  #: Weight of the deviation from the nominal DCM offset [1/m^2]
    cop: Positive  #: Weight of the CoP offset over the rest of the step [1/m^2]
    cop_share: NonNegative  #: Share of the sole that the CoP offset may use [-]
    urgent: Positive  #: DCM error above which a step is urgent, that is, as quick as possible [m]
    capture: NonNegative  #: Weight of the distance by which the next step misses the DCM, to rank regions [1/m^2]
    switch: NonNegative  #: Least decrease of the objective for which a swing foot changes its region [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class RouteConfig:
    """Footsteps to a pose, and lists of footsteps."""

    pace: Share  #: Share of the fast gait in the footsteps [-]
    forward: Positive  #: Longitudinal speed [m/s]
    lateral: Positive  #: Lateral speed [m/s]
    turn: Positive  #: Turning speed [rad/s]
    position_tolerance: Positive  #: Position error at the goal [m]
    turn_tolerance: Positive  #: Heading error at the goal [rad]
    offset_max: Positive  #: Landing error above which the route to the goal is replanned [m]
    range: Positive  #: Largest distance of a goal [m]
    steps_max: Annotated[int, Field(ge=1, le=1000)]  #: Largest number of footsteps in a route
    #: A goal is abandoned after twice the planned footsteps plus this number, if landings still require new plans
    steps_more: Annotated[int, Field(ge=0, le=1000)]


@dataclass(frozen=True, slots=True, config=STRICT)
class GroundConfig:
    """Inclination of the ground, measured by the soles."""

    #: Time constant with which the ground slope follows the tilt of a sole that has just landed [s]
    settle_time: Positive
    settled: Positive  #: Time in single support after which the tilt of the stance sole is used as ground slope [s]
    #: Number of soles, with the stance sole, whose median slope is expected at the next landing
    slope_steps: Annotated[int, Field(ge=1, le=9)]
    slope_max: Positive  #: Steepest expected slope [-]
    level: Positive  #: Largest height difference of known ground on which the feet step ahead in turn [m]
    #: Largest error of the expected landing height on ground that does not count as rough [m]
    even: NonNegative
    rough_max: NonNegative  #: Largest additional height of swing feet on rough ground [m]
    rough_steps: Positive  #: Number of steps in which this height decays [-]
    rough_trip: NonNegative  #: Height of rough ground after a foot has tripped [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class FootingConfig:
    """Detection of soles that bear on a line: an edge of the ground, or their rim."""

    tilted: Positive  #: Rotation from the ground about the line of its CoP from which a sole bears on it [rad]
    #: Largest motion of the CoP on a line, which a sole that rolls as it lands exceeds, and largest distance of a line
    #: from the rim of the sole at which it counts as the rim [m]
    edge: Positive
    still: Positive  #: Angular velocity at and above which the rotation does not decay [rad/s]
    rest_time: Positive  #: Time constant with which the rotation of a sole at rest decays [s]
    lie_angle: NonNegative  #: Angle of a sole on its rim from its tilt to its reference, towards the ground [rad]
    grain: Positive  #: Resolution of the lines; each change requires a new wrench cone in the QP [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class AnkleConfig:
    """Stance ankle at a joint limit in an urgent step: the sole turns over an edge."""

    stop_time: NonNegative  #: Time before the joint reaches its limit at which the sole is planned to turn [s]
    stop_margin: NonNegative  #: Margin of the joint limit, equal to the joint margin of the whole-body QP [rad]
    rim: Positive  #: Largest distance of the CoP from that edge [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class LiftConfig:
    """Detection of a robot that is lifted off the floor."""

    float_time: Positive  #: Time without load on either foot after which the posture is held and the gait waits [s]
    up_time: Positive  #: Time without load on either foot after which the robot counts as lifted and the walk ends [s]
    level_time: Positive  #: Duration of the return to the standing posture, in which the robot can be put down [s]
    down_time: Positive  #: Time with load on both feet after which the robot counts as put down [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class GaitConfig:
    """Parameters of the gait."""

    leg: Positive  #: Hip height above the sole of the robot to which the lengths apply [m]
    foot: tuple[Positive, Positive]  #: Length and width of the foot shape of that robot [m]
    zmp: Share  #: ZMP point of single support, from under the ankle (0) to the middle of the sole (1) [-]
    #: Largest root mean square of a joint's torque in a nominal step, as a share of the torque limit [-]
    torque_share: Fraction
    height_rate: Positive  #: Largest rate of ascent of the CoM height reference [m/s]
    #: Largest acceleration of the CoM height reference; well below gravity, so that the feet bear load [m/s^2]
    height_acceleration: Positive
    #: The same in an urgent step; a foot that bears alone carries the remaining share of the weight [m/s^2]
    height_acceleration_urgent: Annotated[float, Field(gt=0.0, lt=GRAVITY)]
    drop_rate: Positive  #: Largest rate of descent of the CoM height reference [m/s]
    drop_rate_urgent: Positive  #: The same in an urgent step, where the legs reach far in a short time [m/s]
    preview: Annotated[int, Field(ge=1, le=12)]  #: Number of steps in the DCM recursion
    settle_dcm: Positive  #: Largest distance of the DCM from the middle in a settled stance [m]
    settle_speed: Positive  #: Largest speed of the CoM in a settled stance [m/s]
    settle_time: NonNegative  #: Time within both bounds after which the stance is settled [s]
    #: DCM at which a standing robot steps, as a share of the distance from the middle to the edge of both soles [-]
    step_share: Share
    #: Position of the body between the feet at the touchdown of an urgent step, as a share of their distance [-]
    lean_urgent: Share
    push_horizon: NonNegative  #: Expected remaining duration of a push that makes a standing robot step [s]
    push_filter: Positive  #: Time constant of the low-pass filter of the measured DCM rate [s]
    #: Distance of a sole from its nominal place above which the robot steps back after a recovery step [m]
    astride: Positive
    astride_max: Positive  #: Distance above which the robot does not come to rest [m]; greater than ``astride``
    #: Time constant with which planted footholds and their slopes follow the soles that bear load [s]
    anchor_time: Positive
    anchor_load: Share  #: Least share of the weight on a foot for its foothold to follow it [-]
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
