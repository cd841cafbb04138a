"""Schema of ``config/whole_body.yaml`` and ``config/balance.yaml``."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive, Share, default_config, overlaid
from models.robot_model import RobotModel


@dataclass(frozen=True, slots=True, config=STRICT)
class Gains:
    """Feedback and weight of one task."""

    kp: NonNegative  #: Position gain [1/s^2]
    kd: NonNegative  #: Velocity gain [1/s]
    weight: NonNegative  #: Weight of the task [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class CoMGains:
    """CoM task; the balance law computes its horizontal feedback."""

    kp: NonNegative  #: Gain of the height [1/s^2]
    kd: NonNegative  #: Gain of the vertical velocity [1/s]
    weight: NonNegative  #: Weight of the horizontal axes [-]
    weight_height: NonNegative  #: Weight of the vertical axis [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class MomentumGains:
    """Angular momentum; the weights are those of its rate divided by the robot's mass [m^2/s^2]."""

    kd: NonNegative  #: Damping [1/s]
    weight: NonNegative  #: About the horizontal axes [-]
    weight_vertical: NonNegative  #: About the vertical axis: arms and torso swing against the legs [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class ContactConfig:
    """Contacts of the QP."""

    stiffness: NonNegative  #: Position gain of a stance sole towards its foothold [1/s^2]
    damping: NonNegative  #: Velocity gain of a stance sole [1/s]
    linear_max: Positive  #: Largest acceleration from both gains [m/s^2]
    angular_max: Positive  #: The same, angular [rad/s^2]
    friction: Positive  #: Largest Coulomb coefficient of the cones [-]
    friction_share: Share  #: The same as a share of the estimated one [-]
    friction_grain: Positive  #: Resolution of the coefficient: each change costs the QP new wrench cones [-]
    sole_margin: NonNegative  #: Taken off each side of the contact rectangles [m]
    force_min: NonNegative  #: Least normal force per sole, share of the weight [-]
    force_max: Positive  #: Largest normal force per sole, share of the weight [-]
    wrench_weight: Positive  #: Weight of a wrench component's distance from its even share, over the load [-]
    moment_arm: Positive  #: Lever that makes moments comparable with forces in that weight [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class PointTask:
    """A task that holds the origin of a frame at a point; it acts once ``desired`` of the task is set."""

    frame: str  #: Frame of the profile or of the URDF
    kp: NonNegative  #: [1/s^2]
    kd: NonNegative  #: [1/s]
    weight: NonNegative  #: [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class HeightLimit:
    """Bounds of the CoM's height above the lowest sole in contact."""

    enabled: bool  #: Whether the QP has this limit
    minimum: NonNegative  #: Least height [m]
    maximum: Positive  #: Greatest height [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class LegClearanceConfig:
    """Distance of the legs."""

    enabled: bool
    gap: NonNegative  #: Least distance of their shapes [m]
    reach: Positive  #: Distance from which a pair of shapes has a bound [m]
    position_gain: Positive  #: Fastest approach to the gap per distance to it [1/s]
    velocity_gain: Positive  #: Largest acceleration towards that speed per distance to it [1/s]
    acceleration: Positive  #: Largest bound of the distance's acceleration, either way [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class LimitConfig:
    """Joint limits as acceleration bounds."""

    torque: Share  #: Share of the torque limits that the QP may use [-]
    velocity: Share  #: Share of the velocity limits [-]
    position_margin: NonNegative  #: Distance kept from position limits [rad]
    position_gain: Positive  #: Fastest approach to a position limit per distance to it [1/s]
    velocity_gain: Positive  #: Largest acceleration towards a velocity bound per distance to it [1/s]
    acceleration: Positive  #: Largest joint acceleration [rad/s^2]
    com_height: HeightLimit  #: Height of the CoM
    legs: LegClearanceConfig  #: Distance of the legs


@dataclass(frozen=True, slots=True, config=STRICT)
class SolverConfig:
    """QP solution."""

    backend: str  #: own, daqp, or an installed back-end of qpsolvers (osqp, proxqp, piqp, quadprog, ...)
    residual_max: Positive  #: Largest accepted KKT residual [-]
    iterations_max: Annotated[int, Field(gt=0)]  #: Iteration limit of the active-set solver
    soft_rho: Positive  #: Inverse cost of violating relaxed rows [-]
    regularisation: Positive  #: Added to the Hessian's diagonal [-]
    #: Ticks without a solution for which the last torques are repeated before damping
    hold_ticks: Annotated[int, Field(ge=0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class SteppingConfig:
    """Gains that differ while the robot steps; in between they are linear in the share of the gait."""

    com_weight_height: NonNegative  #: ``com.weight_height`` [-]
    com_weight_height_slow: NonNegative  #: The same of a slow gait that nothing disturbs [-]
    momentum_weight_vertical: NonNegative  #: ``angular_momentum.weight_vertical`` [-]
    base_weight: NonNegative  #: ``base_orientation.weight`` [-]
    base_weight_urgent: NonNegative  #: The same in an urgent step [-]
    contact_stiffness: NonNegative  #: ``contact.stiffness`` [1/s^2]
    contact_damping: NonNegative  #: ``contact.damping`` [1/s]
    contact_linear_max: Positive  #: ``contact.linear_max`` [m/s^2]
    contact_angular_max: Positive  #: ``contact.angular_max`` [rad/s^2]
    position_gain: Positive  #: ``limits.position_gain`` [1/s]
    velocity_gain: Positive  #: ``limits.velocity_gain`` [1/s]
    hold_ticks: Annotated[int, Field(ge=0)]  #: ``solver.hold_ticks``


@dataclass(frozen=True, slots=True, config=STRICT)
class WholeBodyConfig:
    """The whole-body QP."""

    com: CoMGains
    angular_momentum: MomentumGains
    base_orientation: Gains
    torso_orientation: Gains
    foot: Gains
    posture: Gains
    posture_leg_scale: NonNegative  #: Factor on the posture weight of the leg joints [-]
    #: Factor on the weight of a swing foot's roll, so that it rolls at a limit of its ankle [-]
    foot_roll_scale: NonNegative
    foot_pitch_scale: NonNegative  #: The same for its pitch: the foot tips rather than the body [-]
    contact: ContactConfig
    limits: LimitConfig
    solver: SolverConfig
    stepping: SteppingConfig  #: What differs while the robot steps
    #: Least integration time from accelerations to the drivers' setpoints; a longer measured look-ahead replaces it [s]
    lookahead_s: NonNegative
    tasks: dict[str, PointTask]  #: Further tasks by name


@dataclass(frozen=True, slots=True, config=STRICT)
class DcmFeedback:
    """DCM feedback."""

    dcm_gain: Positive  #: Feedback of the DCM error, as k in ``p = xi + k (xi - xi_ref)`` [-]
    polygon_margin: NonNegative  #: Distance the commanded CoP keeps from the edge of the support polygon [m]
    #: Distance of the DCM from the edge at which arms and hips start to help; at most 0.4 of the support [m]
    momentum_margin: Annotated[float, Field(ge=-0.2, le=0.2)]
    momentum_gain: NonNegative  #: Commanded CMP beyond the edge per metre past that distance [-]
    momentum_reach_max: NonNegative  #: Farthest commanded CMP beyond the edge [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class BalanceConfig(DcmFeedback):
    """Standing balance."""

    stepping: DcmFeedback  #: Feedback while the robot steps
    reaction_reach_max: NonNegative  #: Farthest that the planned reaction of the swing leg may shift the CMP [m]
    #: Whether a standing robot keeps its feet where they are, as on a table, even where only a step helps
    no_step: bool
    blend_in_s: Positive  #: Time in which references and gains go over to those of the steps [s]
    blend_out_s: Positive  #: Time in which they return to those of standing [s]
    stand_up_s: Positive  #: Time in which a walk that begins takes the robot to the 'stand' posture [s]
    motion_fade: Positive  #: Time in which a motion of the arms is blended into a walk and out of it again [s]
    anchor_time_s: Positive  #: Time constant with which footholds and references follow the soles that bear load [s]
    stop_time_s: Positive  #: Time in which a motion that is stopped comes to rest [s]
    setpoint_time_s: Positive  #: Least time in which a lone point without velocities is reached [s]
    foothold_load: Share  #: Share of the weight that a foot must bear for its foothold to follow it [-]


def load_balance_config(model: RobotModel) -> BalanceConfig:
    """The packaged ``balance.yaml`` with ``laws`` of the robot's profile; ``ConfigError`` names a wrong key."""
    laws, packaged = model.profile.laws, default_config(BalanceConfig, "controllers", "balance")
    return overlaid(packaged, laws.get("balance", {}), f"{model.profile.source}: laws.balance")


def load_whole_body_config(model: RobotModel) -> WholeBodyConfig:
    """The packaged ``whole_body.yaml`` with ``laws`` of the robot's profile; ``ConfigError`` names a wrong key."""
    laws, packaged = model.profile.laws, default_config(WholeBodyConfig, "controllers", "whole_body")
    return overlaid(packaged, laws.get("whole_body", {}), f"{model.profile.source}: laws.whole_body")
