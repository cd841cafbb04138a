"""Schema of ``planners/config/motion.yaml``."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, Fraction, NonNegative, Positive, Share


@dataclass(frozen=True, slots=True, config=STRICT)
class LimitConfig:
    """Limits of a motion, relative to those of the joints."""

    velocity_fraction: Share  #: share of the velocity limit [1]
    acceleration: Positive  #: largest joint acceleration [rad/s^2]
    slowdown: Annotated[float, Field(ge=1.0)]  #: largest factor that slows a whole motion [1]
    joint_margin: NonNegative  #: distance kept from joint limits [rad]
    start_overrun: NonNegative  #: overrun of a start posture that is clipped [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class BalanceConfig:
    """Statics: where the CoM and the soles may be, and what the joints may bear."""

    com_margin: NonNegative  #: CoM to edge of the support polygon [m]
    com_margin_start: NonNegative  #: the same, at which a start is refused [m]
    sole_tilt: Positive  #: sole against the mean plane at the start [rad]
    sole_step: Positive  #: sole above the mean plane at the start [m]
    sole_drift: Positive  #: change of the distance between the soles [m]
    sole_turn: Positive  #: change of the angle between the soles [rad]
    base_tilt: Positive  #: of the base [rad]
    torque_share: Fraction  #: of a joint's torque limit that a posture takes at rest [1]


@dataclass(frozen=True, slots=True, config=STRICT)
class CollisionConfig:
    """Self-collision."""

    margin: NonNegative  #: distance kept between bodies [m]
    path_slack: NonNegative  #: less distance allowed between key poses [m]
    trigger: Positive  #: distance at which the solver reacts [m]
    near: Count  #: bodies this many joints apart are not checked [1]
    check_rate: Positive  #: checked points per second [Hz]


@dataclass(frozen=True, slots=True, config=STRICT)
class SolverConfig:
    """Iterations and tolerances."""

    iterations_max: Count  #: steps towards one key pose [1]
    step: Positive  #: largest joint step of one iteration [rad]
    settled: Positive  #: step at which a key pose has converged [rad]
    rounds: Annotated[int, Field(ge=2)]  #: times a key pose is solved anew [1]
    relaxed_habits: Fraction  #: factor on all but the targets' weights [1]
    path_iterations: Count  #: steps at a point between key poses [1]
    position_tolerance: Positive  #: error of a reached position [m]
    orientation_tolerance: Positive  #: error of a reached orientation [rad]
    joint_tolerance: Positive  #: error of a reached joint target [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class WeightConfig:
    """Cost of one unit of squared error in the key-pose problem."""

    target_position: Positive  #: hand or foot from its target position [1/m^2]
    target_orientation: Positive  #: hand or foot from its target orientation [1/rad^2]
    target_joint: Positive  #: joint from its target [1/rad^2]
    com: Positive  #: CoM over its nominal place [1/m^2]
    base_height: Positive  #: height of the base from its target [1/m^2]
    base_orientation: Positive  #: base from its target orientation [1/rad^2]
    torso_orientation: Positive  #: torso from its target orientation [1/rad^2]
    posture: Positive  #: joints from the nominal posture [1/rad^2]
    idle_posture: Positive  #: posture of joints that no target needs [1/rad^2]
    leg_posture: Positive  #: posture of the legs [1/rad^2]
    damping: Positive  #: change of the joints in an iteration [1/rad^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class PoseConfig:
    """Motions to a pose that is given at run time."""

    min_duration: Positive  #: shortest motion without a requested duration [s]
    duration_max: Annotated[float, Field(gt=0.0, le=90.0)]  #: longest duration that may be requested [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class SizeConfig:
    """Motions for limbs that do not reach as far as a motion file asks."""

    least: Share  #: smallest share of its offsets and angles with which a motion is still planned [1]
    step: Share  #: steps in which the share is reduced [1]


@dataclass(frozen=True, slots=True, config=STRICT)
class MotionConfig:
    """Parameters of ``MotionPlanner``."""

    sample_rate: Annotated[float, Field(ge=50.0, le=500.0)]  #: points per second [Hz]
    limits: LimitConfig
    balance: BalanceConfig
    collision: CollisionConfig
    solver: SolverConfig
    weights: WeightConfig
    pose: PoseConfig
    size: SizeConfig
