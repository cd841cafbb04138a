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
    """Gains of the CoM task; the balance law computes the horizontal feedback."""

    kp: NonNegative  #: Position gain of the height [1/s^2]
    kd: NonNegative  #: Velocity gain of the height [1/s]
    weight: NonNegative  #: Weight of the horizontal axes [-]
    weight_height: NonNegative  #: Weight of the vertical axis [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class MomentumGains:
    """Angular-momentum task; the weights apply to the rate of the momentum over the robot's mass [m^2/s^2]."""

    kd: NonNegative  #: Damping [1/s]
    weight: NonNegative  #: Weight about the horizontal axes [-]
    weight_vertical: NonNegative  #: Weight about the vertical axis; makes arms and torso swing against the legs [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class ContactConfig:
    """Contacts of the QP."""

    stiffness: NonNegative  #: Position gain of a stance sole towards its foothold [1/s^2]
    damping: NonNegative  #: Velocity gain of a stance sole [1/s]
    linear_max: Positive  #: Largest acceleration from both gains [m/s^2]
    angular_max: Positive  #: Largest angular acceleration from both gains [rad/s^2]
    friction: Positive  #: Largest Coulomb coefficient of the cones [-]
    friction_share: Share  #: Coulomb coefficient of the cones as a share of the estimate [-]
    friction_grain: Positive  #: Resolution of the coefficient; each change requires new wrench cones [-]
    sole_margin: NonNegative  #: Margin by which each side of the contact rectangles is reduced [m]
    force_min: NonNegative  #: Least normal force per sole, share of the weight [-]
    force_max: Positive  #: Largest normal force per sole, share of the weight [-]
    wrench_weight: Positive  #: Weight of a wrench component's distance from its even share, over the load [-]
    moment_arm: Positive  #: Lever arm by which moments are divided in this cost [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class PointTask:
    """A task that holds the origin of a frame at a point; inactive until its ``desired`` point is set."""

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
    reach: Positive  #: Distance below which a pair of shapes is bounded [m]
    position_gain: Positive  #: Largest approach speed per distance to the gap [1/s]
    velocity_gain: Positive  #: Bound of the acceleration per difference from this speed [1/s]
    acceleration: Positive  #: Largest magnitude of the bound on the acceleration of the distance [m/s^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class LimitConfig:
    """Joint limits as acceleration bounds."""

    torque: Share  #: Share of the torque limits that the QP may use [-]
    velocity: Share  #: Share of the velocity limits [-]
    position_margin: NonNegative  #: Distance kept from position limits [rad]
    position_gain: Positive  #: Largest approach speed per distance to a position limit [1/s]
    velocity_gain: Positive  #: Largest acceleration per difference from a velocity bound [1/s]
    acceleration: Positive  #: Largest joint acceleration [rad/s^2]
    com_height: HeightLimit  #: Height of the CoM
    legs: LegClearanceConfig  #: Distance of the legs


@dataclass(frozen=True, slots=True, config=STRICT)
class SolverConfig:
    """Solver of the QP."""

    backend: str  #: own, daqp, or an installed back-end of qpsolvers (osqp, proxqp, piqp, quadprog, ...)
    residual_max: Positive  #: Largest accepted KKT residual [-]
    iterations_max: Annotated[int, Field(gt=0)]  #: Iteration limit of the active-set solver
    soft_rho: Positive  #: Inverse cost of violating relaxed rows [-]
    regularisation: Positive  #: Added to the Hessian's diagonal [-]
    #: Number of ticks without a solution in which the last command is repeated, before damping
    hold_ticks: Annotated[int, Field(ge=0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class SteppingConfig:
    """Gains while the robot steps, interpolated from standing linearly in the share of the gait."""

    com_weight_height: NonNegative  #: ``com.weight_height`` [-]
    com_weight_height_slow: NonNegative  #: ``com.weight_height`` in an undisturbed slow gait [-]
    momentum_weight_vertical: NonNegative  #: ``angular_momentum.weight_vertical`` [-]
    base_weight: NonNegative  #: ``base_orientation.weight`` [-]
    base_weight_urgent: NonNegative  #: ``base_orientation.weight`` in an urgent step [-]
    contact_stiffness: NonNegative  #: ``contact.stiffness`` [1/s^2]
    contact_damping: NonNegative  #: ``contact.damping`` [1/s]
    contact_linear_max: Positive  #: ``contact.linear_max`` [m/s^2]
    contact_angular_max: Positive  #: ``contact.angular_max`` [rad/s^2]
    position_gain: Positive  #: ``limits.position_gain`` [1/s]
    velocity_gain: Positive  #: ``limits.velocity_gain`` [1/s]
    hold_ticks: Annotated[int, Field(ge=0)]  #: ``solver.hold_ticks``


@dataclass(frozen=True, slots=True, config=STRICT)
class WholeBodyConfig:
    """Schema of ``controllers/config/whole_body.yaml``."""

    com: CoMGains
    angular_momentum: MomentumGains
    base_orientation: Gains
    torso_orientation: Gains
    foot: Gains
    posture: Gains
    posture_leg_scale: NonNegative  #: Factor on the posture weight of the leg joints [-]
    #: Factor on the roll weight of a swing foot, so that the foot rolls when its ankle is at a limit [-]
    foot_roll_scale: NonNegative
    foot_pitch_scale: NonNegative  #: Factor on the pitch weight of a swing foot, so that it tips, not the body [-]
    contact: ContactConfig
    limits: LimitConfig
    solver: SolverConfig
    stepping: SteppingConfig  #: Gains while the robot steps
    #: Least integration time from acceleration to the drivers' setpoints, replaced by a longer measured look-ahead [s]
    lookahead_s: NonNegative
    tasks: dict[str, PointTask]  #: Further tasks by name


@dataclass(frozen=True, slots=True, config=STRICT)
class DcmFeedback:
    """DCM feedback."""

    dcm_gain: Positive  #: Gain of the DCM error, k in ``p = xi + k (xi - xi_ref)`` [-]
    polygon_margin: NonNegative  #: Least distance of the commanded CoP from the edge of the support polygon [m]
    #: Distance of the DCM from the edge below which arms and hips act; at most 0.4 of the width of the support [m]
    momentum_margin: Annotated[float, Field(ge=-0.2, le=0.2)]
    momentum_gain: NonNegative  #: Distance of the commanded CMP beyond the edge per excess over that distance [-]
    momentum_reach_max: NonNegative  #: Largest distance of the commanded CMP beyond the edge [m]


@dataclass(frozen=True, slots=True, config=STRICT)
class BalanceConfig(DcmFeedback):
    """Schema of ``controllers/config/balance.yaml``."""

    stepping: DcmFeedback  #: Feedback while the robot steps
    reaction_reach_max: NonNegative  #: Largest shift of the CMP by the planned reaction of the swing leg [m]
    #: Disables recovery steps of a standing robot, as for a robot on a table
    no_step: bool
    blend_in_s: Positive  #: Duration of the transition of references and gains from standing to stepping [s]
    blend_out_s: Positive  #: Duration of the transition of references and gains from stepping to standing [s]
    stand_up_s: Positive  #: Duration of the motion to the 'stand' posture at the start of a walk [s]
    motion_fade: Positive  #: Duration of the blend of an arm motion into and out of a walk [s]
    anchor_time_s: Positive  #: Time constant of footholds and references that follow the loaded soles [s]
    stop_time_s: Positive  #: Duration of the deceleration of a stopped motion [s]
    setpoint_time_s: Positive  #: Least time to reach a single point without velocities [s]
    foothold_load: Share  #: Share of the weight that a foot must bear for its foothold to follow it [-]


def load_balance_config(model: RobotModel) -> BalanceConfig:
    """Packaged ``balance.yaml`` overlaid with ``laws`` of the robot's profile; ``ConfigError`` names a wrong key."""
    laws, packaged = model.profile.laws, default_config(BalanceConfig, "controllers", "balance")
    return overlaid(packaged, laws.get("balance", {}), f"{model.profile.source}: laws.balance")


def load_whole_body_config(model: RobotModel) -> WholeBodyConfig:
    """Packaged ``whole_body.yaml`` overlaid with ``laws`` of the robot's profile; ``ConfigError`` names a wrong key."""
    laws, packaged = model.profile.laws, default_config(WholeBodyConfig, "controllers", "whole_body")
    return overlaid(packaged, laws.get("whole_body", {}), f"{model.profile.source}: laws.whole_body")
