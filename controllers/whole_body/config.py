"""Schema of ``config/whole_body.yaml`` and ``config/balance.yaml``."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, NonNegative, Positive

Fraction = Annotated[float, Field(gt=0.0, le=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class Gains:
    """Feedback and weight of one task: kp [1/s^2], kd [1/s], weight [-]."""

    kp: NonNegative
    kd: NonNegative
    weight: NonNegative


@dataclass(frozen=True, slots=True, config=STRICT)
class CoMGains:
    """CoM task. The horizontal feedback is the balance law's; kp, kd [1/s^2, 1/s] act on the height."""

    kp: NonNegative
    kd: NonNegative
    weight: NonNegative
    weight_height: NonNegative


@dataclass(frozen=True, slots=True, config=STRICT)
class MomentumGains:
    """Angular momentum: kd [1/s]; weights [-] of the rate divided by the robot's mass [m^2/s^2]."""

    kd: Annotated[NonNegative, Field(description="Damping [1/s]")]
    weight: Annotated[NonNegative, Field(description="About the horizontal axes [-]")]
    weight_vertical: Annotated[
        NonNegative, Field(description="About the vertical axis: arms and torso swing against the legs [-]")
    ]


@dataclass(frozen=True, slots=True, config=STRICT)
class ContactConfig:
    """Contacts of the QP."""

    stiffness: Annotated[NonNegative, Field(description="Draws a planted sole to its foothold [1/s^2]")]
    damping: Annotated[NonNegative, Field(description="Draws its velocity to zero [1/s]")]
    linear_max: Annotated[Positive, Field(description="Largest acceleration that both may ask of a sole [m/s^2]")]
    angular_max: Annotated[Positive, Field(description="The same, angular [rad/s^2]")]
    friction: Annotated[Positive, Field(description="Coulomb coefficient of the cones [-]")]
    sole_margin: Annotated[NonNegative, Field(description="Taken off each side of the contact rectangles [m]")]
    force_min: Annotated[NonNegative, Field(description="Least normal force per sole, share of the weight [-]")]
    force_max: Annotated[Positive, Field(description="Largest normal force per sole, share of the weight [-]")]
    wrench_weight: Annotated[
        Positive,
        Field(description="Weight of a wrench component's distance from its even share, over the load [-]"),
    ]
    moment_arm: Annotated[
        Positive, Field(description="Lever that makes moments comparable with forces in that weight [m]")
    ]


@dataclass(frozen=True, slots=True, config=STRICT)
class PointTask:
    """A task that holds the origin of a frame at a point; it acts once ``desired`` of the task is set."""

    frame: Annotated[str, Field(description="Frame of the profile or of the URDF")]
    kp: Annotated[NonNegative, Field(description="[1/s^2]")]
    kd: Annotated[NonNegative, Field(description="[1/s]")]
    weight: Annotated[NonNegative, Field(description="[-]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class HeightLimit:
    """Bounds of the CoM's height above the lowest sole in contact."""

    enabled: Annotated[bool, Field(description="Whether the QP has this limit")]
    minimum: Annotated[NonNegative, Field(description="Least height [m]")]
    maximum: Annotated[Positive, Field(description="Greatest height [m]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class LimitConfig:
    """Joint limits as acceleration bounds."""

    torque: Annotated[Fraction, Field(description="Share of the torque limits that the QP may use [-]")]
    velocity: Annotated[Fraction, Field(description="Share of the velocity limits [-]")]
    position_margin: Annotated[NonNegative, Field(description="Distance kept from position limits [rad]")]
    position_gain: Annotated[
        Positive, Field(description="Fastest approach to a position limit per distance to it [1/s]")
    ]
    velocity_gain: Annotated[
        Positive, Field(description="Largest acceleration towards a velocity bound per distance to it [1/s]")
    ]
    acceleration: Annotated[Positive, Field(description="Largest joint acceleration [rad/s^2]")]
    com_height: Annotated[HeightLimit, Field(description="Height of the CoM")]


@dataclass(frozen=True, slots=True, config=STRICT)
class SolverConfig:
    """QP solution."""

    backend: Annotated[
        str, Field(description="own, daqp, or an installed back-end of qpsolvers (osqp, proxqp, piqp, quadprog, ...)")
    ]
    residual_max: Annotated[Positive, Field(description="Largest accepted KKT residual [-]")]
    iterations_max: Annotated[int, Field(gt=0, description="Iteration limit of the active-set solver")]
    soft_rho: Annotated[Positive, Field(description="Price of relaxed rows (smaller is dearer) [-]")]
    regularisation: Annotated[Positive, Field(description="Added to the Hessian's diagonal [-]")]
    hold_ticks: Annotated[
        int, Field(ge=0, description="Ticks without a solution for which the last torques are repeated before damping")
    ]


@dataclass(frozen=True, slots=True, config=STRICT)
class SteppingConfig:
    """Gains that differ while the robot steps; in between they are linear in the share of the gait."""

    com_weight_height: Annotated[NonNegative, Field(description="``com.weight_height`` [-]")]
    momentum_weight_vertical: Annotated[NonNegative, Field(description="``angular_momentum.weight_vertical`` [-]")]
    base_weight: Annotated[NonNegative, Field(description="``base_orientation.weight`` [-]")]
    contact_stiffness: Annotated[NonNegative, Field(description="``contact.stiffness`` [1/s^2]")]
    contact_damping: Annotated[NonNegative, Field(description="``contact.damping`` [1/s]")]
    contact_linear_max: Annotated[Positive, Field(description="``contact.linear_max`` [m/s^2]")]
    contact_angular_max: Annotated[Positive, Field(description="``contact.angular_max`` [rad/s^2]")]
    position_gain: Annotated[Positive, Field(description="``limits.position_gain`` [1/s]")]
    velocity_gain: Annotated[Positive, Field(description="``limits.velocity_gain`` [1/s]")]
    hold_ticks: Annotated[int, Field(ge=0, description="``solver.hold_ticks``")]


@dataclass(frozen=True, slots=True, config=STRICT)
class WholeBodyConfig:
    """The whole-body QP."""

    com: CoMGains
    angular_momentum: MomentumGains
    base_orientation: Gains
    torso_orientation: Gains
    foot: Gains
    posture: Gains
    posture_leg_scale: Annotated[NonNegative, Field(description="Factor on the posture weight of the leg joints [-]")]
    foot_roll_scale: Annotated[
        NonNegative,
        Field(description="Factor on the weight of a swing foot's roll, so that it rolls at a limit of its ankle [-]"),
    ]
    foot_pitch_scale: Annotated[
        NonNegative, Field(description="Likewise of its pitch: rather than the body, the foot tips [-]")
    ]
    contact: ContactConfig
    limits: LimitConfig
    solver: SolverConfig
    stepping: Annotated[SteppingConfig, Field(description="What differs while the robot steps")]
    lookahead_s: Annotated[
        NonNegative,
        Field(description="Integration time from accelerations to the drivers' setpoints [s]"),
    ]
    tasks: Annotated[dict[str, PointTask], Field(description="Further tasks by name")]


@dataclass(frozen=True, slots=True, config=STRICT)
class DcmFeedback:
    """DCM feedback.

    Attributes:
        dcm_gain: Feedback of the DCM error, as k in ``p = xi + k (xi - xi_ref)`` [-].
        polygon_margin: Distance the commanded CoP keeps from the edge of the support polygon [m].
        momentum_margin: Distance of the DCM from the edge at which arms and hips start to help [m].
        momentum_gain: Commanded CMP beyond the edge per metre past that distance [-].
        momentum_reach_max: Farthest commanded CMP beyond the edge [m].
    """

    dcm_gain: Positive
    polygon_margin: NonNegative
    momentum_margin: Annotated[float, Field(ge=-0.2, le=0.2)]
    momentum_gain: NonNegative
    momentum_reach_max: NonNegative


@dataclass(frozen=True, slots=True, config=STRICT)
class BalanceConfig(DcmFeedback):
    """Standing balance.

    Attributes:
        stepping: Feedback while the robot steps.
        reaction_reach_max: Farthest that the planned reaction of the swing leg may shift the CMP [m].
        no_step: Whether a standing robot keeps its feet where they are, as on a table, even where only a step helps.
        blend_in_s: Time in which references and gains go over to those of the steps [s].
        blend_out_s: Time in which they return to those of standing [s].
        stand_up_s: Time in which a walk that begins takes the robot to the 'stand' posture [s].
        motion_fade: Time in which a motion of the arms is blended into a walk and out of it again [s].
        anchor_time_s: Time constant with which footholds and references follow the soles that bear load [s].
        stop_time_s: Time in which a motion that is stopped comes to rest [s].
        set_point_time_s: Least time in which a lone point without velocities is reached [s].
        foothold_load: Share of the weight that a foot must bear for its foothold to follow it [-].
    """

    stepping: DcmFeedback
    reaction_reach_max: NonNegative
    no_step: bool
    blend_in_s: Positive
    blend_out_s: Positive
    stand_up_s: Positive
    motion_fade: Positive
    anchor_time_s: Positive
    stop_time_s: Positive
    set_point_time_s: Positive
    foothold_load: Fraction
