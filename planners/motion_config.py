"""Schema of ``planners/config/motion.yaml``."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Count, Fraction, NonNegative, Positive, Share


@dataclass(frozen=True, slots=True, config=STRICT)
class LimitConfig:
    """Limits of the joint motion."""

    velocity_fraction: Share  #: share of a joint's velocity limit that a motion may use [1]
    acceleration: Positive  #: largest joint acceleration [rad/s^2]
    slowdown: Annotated[float, Field(ge=1.0)]  #: largest factor by which a whole motion is slowed [1]
    joint_margin: NonNegative  #: least distance from the joint limits [rad]
    start_overrun: NonNegative  #: largest violation of the joint limits by a start posture, which is clipped [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class BalanceConfig:
    """Static balance: bounds of the CoM, the soles, the base and the joint torques."""

    com_margin: NonNegative  #: least distance of the CoM from the edge of the support polygon [m]
    com_margin_start: NonNegative  #: least distance of the CoM from that edge in a start posture [m]
    sole_tilt: Positive  #: largest angle between a sole and the mean plane of the soles at the start [rad]
    sole_step: Positive  #: largest distance of a sole from the mean plane of the soles at the start [m]
    sole_drift: Positive  #: largest change of the relative position of the soles [m]
    sole_turn: Positive  #: largest change of the relative orientation of the soles [rad]
    base_tilt: Positive  #: largest tilt of the base [rad]
    torque_share: Fraction  #: largest share of a joint's torque limit in a posture at rest [1]


@dataclass(frozen=True, slots=True, config=STRICT)
class CollisionConfig:
    """Self-collision."""

    margin: NonNegative  #: least distance between bodies at key poses [m]
    path_slack: NonNegative  #: reduction of that distance between key poses [m]
    trigger: Positive  #: distance at which the solver starts to keep bodies apart [m]
    near: Count  #: bodies at most this many joints apart are not checked [1]
    check_rate: Positive  #: checked points of the trajectory per second [Hz]


@dataclass(frozen=True, slots=True, config=STRICT)
class SolverConfig:
    """Iterations and tolerances."""

    iterations_max: Count  #: largest number of iterations for one key pose [1]
    step: Positive  #: largest joint step of one iteration [rad]
    settled: Positive  #: joint step below which a key pose has converged [rad]
    rounds: Annotated[int, Field(ge=2)]  #: largest number of times that a key pose is solved [1]
    relaxed_habits: Fraction  #: factor on all weights other than those of the targets [1]
    path_iterations: Count  #: largest number of iterations for a point between key poses [1]
    position_tolerance: Positive  #: largest error of a reached position [m]
    orientation_tolerance: Positive  #: largest error of a reached orientation [rad]
    joint_tolerance: Positive  #: largest error of a reached joint target [rad]


@dataclass(frozen=True, slots=True, config=STRICT)
class WeightConfig:
    """Weights of squared errors in the key-pose problem."""

    target_position: Positive  #: position error of a target frame [1/m^2]
    target_orientation: Positive  #: orientation error of a target frame [1/rad^2]
    target_joint: Positive  #: error of a joint target [1/rad^2]
    com: Positive  #: horizontal distance of the CoM from its nominal position [1/m^2]
    base_height: Positive  #: error of the nominal base height [1/m^2]
    base_orientation: Positive  #: error of the nominal base orientation [1/rad^2]
    torso_orientation: Positive  #: error of the nominal torso orientation [1/rad^2]
    posture: Positive  #: deviation of the joints from the preferred posture [1/rad^2]
    idle_posture: Positive  #: deviation from that posture of joints that move no target frame [1/rad^2]
    leg_posture: Positive  #: deviation from that posture of the leg joints [1/rad^2]
    damping: Positive  #: displacement in an iteration [1/rad^2]


@dataclass(frozen=True, slots=True, config=STRICT)
class PoseConfig:
    """Motions to a pose given at run time."""

    min_duration: Positive  #: least duration if none is requested [s]
    duration_max: Annotated[float, Field(gt=0.0, le=90.0)]  #: longest duration that may be requested [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class SizeConfig:
    """Reduction of motions that the robot cannot execute at full size."""

    least: Share  #: least share of its offsets and angles at which a motion is planned [1]
    step: Share  #: step by which the share is reduced [1]


@dataclass(frozen=True, slots=True, config=STRICT)
class MotionConfig:
    """Parameters of ``MotionPlanner``."""

    sample_rate: Annotated[float, Field(ge=50.0, le=500.0)]  #: points of a planned trajectory per second [Hz]
    limits: LimitConfig
    balance: BalanceConfig
    collision: CollisionConfig
    solver: SolverConfig
    weights: WeightConfig
    pose: PoseConfig
    size: SizeConfig
