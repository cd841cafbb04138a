"""Schema of ``models/config/proposal.yaml``: assumptions about data that a URDF does not contain."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Fraction, NonNegative, Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class RepairConfig:
    """Assumptions about joints of an incomplete URDF."""

    torque: Positive  # assumed torque limit, over mass, gravity and length of the longest chain [-]
    velocity: Positive  # assumed velocity limit [rad/s]
    range: Positive  # assumed position limits, to both sides [rad]
    light: Fraction  # moved mass below which a joint without torque limit is fixed, over the robot's mass [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class SoleConfig:
    """Detection of soles from the geometry of the feet."""

    mirror: Positive  # maximum distance of a joint from the mirror image of its partner [m]
    band: Positive  # points up to this height above the lowest point of a foot belong to the sole [m]
    inset: NonNegative  # margin on every side of a sole outline [m]
    length_min: Positive  # minimum length of a sole, over the length of the leg [-]
    width_min: Positive  # minimum width of a sole, over the length of the leg [-]
    lopsided: Annotated[float, Field(gt=1.0)]  # ratio of the ankle's overhangs above which the longer one is the toe
    ankle: Positive  # assumed height of the ankle for a foot without shape, over the length of the leg [-]
    heel: Positive  # assumed extent of such a foot behind the ankle, over the length of the leg [-]
    toe: Positive  # assumed extent ahead of the ankle, over the length of the leg [-]
    half_width: Positive  # assumed half width, over the length of the leg [-]
    friction: Positive  # Coulomb coefficient of sole on floor [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class DriveConfig:
    """Scaling of drives by mass m, CoM height h and torque limit tau; see ``models/proposal/propose.py``."""

    armature_torque: Positive  # rotor inertia over tau h / g [-]
    armature_min: Positive  # minimum rotor inertia over m h^2 [-]
    armature_max: Positive  # maximum rotor inertia over m h^2 [-]
    friction: Positive  # maximum viscous (at 1 rad/s) and dry friction over tau [-]
    rise: Positive  # rise time of the torque to its limit [s]
    stiffness: Positive  # kp over sqrt(tau m g h) [1/rad]
    damping_time: Positive  # kd / kp over sqrt(h / g) [-]
    damping_max: Positive  # maximum kd over inertia per tick of the drivers [-]
    tick: Positive  # tick of the drivers [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class PostureConfig:
    """Standing posture."""

    knee: Positive  # bend of the knees from the stretched leg [rad]
    knee_least: Positive  # minimum bend of knees with little torque [rad]
    torque_share: Fraction  # maximum share of a knee's torque limit for standing on one leg [-]
    gap: Positive  # minimum distance between the inner edges of the soles [m]
    margin: Fraction  # distance of every joint from its limits, over its range [-]
    level: Positive  # maximum tilt of a flat sole [rad]
    residual: Positive  # maximum position error [m]
    # Position of the wrist relative to the shoulder over the arm's length: forward, outward, up [-].
    hands: Annotated[tuple[tuple[float, float, float], ...], Field(min_length=1)]


@dataclass(frozen=True, slots=True, config=STRICT)
class ProposalConfig:
    """Assumptions of a proposal."""

    repair: RepairConfig
    sole: SoleConfig
    drive: DriveConfig
    posture: PostureConfig
