"""Schema of ``planners/config/motion.yaml``."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT


@dataclass(frozen=True, slots=True, config=STRICT)
class LimitConfig:
    """Limits of a motion, relative to those of the joints."""

    velocity_fraction: Annotated[float, Field(gt=0.0, le=1.0, description="share of the velocity limit [1]")]
    acceleration: Annotated[float, Field(gt=0.0, description="largest joint acceleration [rad/s^2]")]
    slowdown: Annotated[float, Field(ge=1.0, description="largest factor that slows a whole motion [1]")]
    joint_margin: Annotated[float, Field(ge=0.0, description="distance kept from joint limits [rad]")]
    start_overrun: Annotated[float, Field(ge=0.0, description="overrun of a start posture that is clipped [rad]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class BalanceConfig:
    """Statics: where the CoM and the soles may be."""

    com_margin: Annotated[float, Field(ge=0.0, description="CoM to edge of the support polygon [m]")]
    com_margin_start: Annotated[float, Field(ge=0.0, description="the same, at which a start is refused [m]")]
    sole_tilt: Annotated[float, Field(gt=0.0, description="sole against the mean plane at the start [rad]")]
    sole_step: Annotated[float, Field(gt=0.0, description="sole above the mean plane at the start [m]")]
    sole_drift: Annotated[float, Field(gt=0.0, description="change of the distance between the soles [m]")]
    sole_turn: Annotated[float, Field(gt=0.0, description="change of the angle between the soles [rad]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class CollisionConfig:
    """Self-collision."""

    margin: Annotated[float, Field(ge=0.0, description="distance kept between bodies [m]")]
    path_slack: Annotated[float, Field(ge=0.0, description="less distance allowed between key poses [m]")]
    trigger: Annotated[float, Field(gt=0.0, description="distance at which the solver reacts [m]")]
    near: Annotated[int, Field(ge=1, description="bodies this many joints apart are not checked [1]")]
    check_rate: Annotated[float, Field(gt=0.0, description="checked points per second [Hz]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class SolverConfig:
    """Iterations and tolerances."""

    max_iterations: Annotated[int, Field(ge=1, description="steps towards one key pose [1]")]
    step: Annotated[float, Field(gt=0.0, description="largest joint step of one iteration [rad]")]
    settled: Annotated[float, Field(gt=0.0, description="step at which a key pose has converged [rad]")]
    rounds: Annotated[int, Field(ge=2, description="times a key pose is solved anew [1]")]
    relaxed_habits: Annotated[float, Field(gt=0.0, lt=1.0, description="factor on all but the targets' weights [1]")]
    path_iterations: Annotated[int, Field(ge=1, description="steps at a point between key poses [1]")]
    position_tolerance: Annotated[float, Field(gt=0.0, description="error of a reached position [m]")]
    orientation_tolerance: Annotated[float, Field(gt=0.0, description="error of a reached orientation [rad]")]
    joint_tolerance: Annotated[float, Field(gt=0.0, description="error of a reached joint target [rad]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class WeightConfig:
    """Cost of one unit of squared error in the key-pose problem."""

    target_position: Annotated[float, Field(gt=0.0, description="hand or foot from its target position [1/m^2]")]
    target_orientation: Annotated[
        float, Field(gt=0.0, description="hand or foot from its target orientation [1/rad^2]")
    ]
    target_joint: Annotated[float, Field(gt=0.0, description="joint from its target [1/rad^2]")]
    com: Annotated[float, Field(gt=0.0, description="CoM over its nominal place [1/m^2]")]
    base_height: Annotated[float, Field(gt=0.0, description="height of the base from its target [1/m^2]")]
    base_orientation: Annotated[float, Field(gt=0.0, description="base from its target orientation [1/rad^2]")]
    torso_orientation: Annotated[float, Field(gt=0.0, description="torso from its target orientation [1/rad^2]")]
    posture: Annotated[float, Field(gt=0.0, description="joints from the nominal posture [1/rad^2]")]
    idle_posture: Annotated[float, Field(gt=0.0, description="posture of joints that no target needs [1/rad^2]")]
    leg_posture: Annotated[float, Field(gt=0.0, description="posture of the legs [1/rad^2]")]
    damping: Annotated[float, Field(gt=0.0, description="change of the joints in an iteration [1/rad^2]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class PoseConfig:
    """Motions to a pose that is given at run time."""

    min_duration: Annotated[float, Field(gt=0.0, description="used when none is asked for [s]")]
    max_duration: Annotated[float, Field(gt=0.0, le=90.0, description="longest that may be asked for [s]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class MotionConfig:
    """Parameters of ``MotionPlanner``."""

    sample_rate: Annotated[float, Field(ge=50.0, le=500.0, description="points per second [Hz]")]
    limits: LimitConfig
    balance: BalanceConfig
    collision: CollisionConfig
    solver: SolverConfig
    weights: WeightConfig
    pose: PoseConfig
