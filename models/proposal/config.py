"""Schema of ``models/config/proposal.yaml``: assumptions about a robot where its URDF is silent."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, Fraction, NonNegative, Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class RepairConfig:
    """Joints of an incomplete URDF."""

    torque: Positive  # torque limit where there is none, over mass, gravity and length of the longest chain [-]
    velocity: Positive  # velocity limit where there is none [rad/s]
    range: Positive  # position limits where there are none, to both sides [rad]
    light: Fraction  # mass moved by a joint without torque below which it is fixed, over the robot's mass [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class SoleConfig:
    """Soles from the shapes of the feet."""

    mirror: Positive  # largest distance of a joint from the mirror image of its partner [m]
    band: Positive  # height above the lowest point of a foot up to which its points belong to the sole [m]
    inset: NonNegative  # taken off every side of a sole whose outline is a mesh or a box [m]
    length_min: Positive  # shortest sole that a robot can stand on, over the length of the leg [-]
    width_min: Positive  # narrowest such sole, over the length of the leg [-]
    lopsided: Annotated[float, Field(gt=1.0)]  # ratio of both overhangs of the ankle above which the longer is the toe
    ankle: Positive  # height of an ankle without any shape below it, over the length of the leg [-]
    heel: Positive  # start of such a foot behind the ankle, over the length of the leg [-]
    toe: Positive  # its end ahead of the ankle, over the length of the leg [-]
    half_width: Positive  # over the length of the leg [-]
    friction: Positive  # Coulomb coefficient of sole on floor [-]


@dataclass(frozen=True, slots=True, config=STRICT)
class DriveConfig:
    """Drives by mass m, height h of the CoM, and torque limit tau; see ``models/proposal/propose.py``."""

    armature_torque: Positive  # rotor inertia over tau h / g [-]
    armature_min: Positive  # least rotor inertia over m h^2 [-]
    armature_max: Positive  # largest rotor inertia over m h^2 [-]
    friction: Positive  # largest viscous (at 1 rad/s) and dry friction over tau [-]
    rise: Positive  # time in which the torque rises to its limit [s]
    stiffness: Positive  # kp over sqrt(tau m g h) [1/rad]
    damping_time: Positive  # kd / kp over sqrt(h / g) [-]
    damping_max: Positive  # kd over inertia per tick of the drivers [-]
    tick: Positive  # tick of the drivers [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class PostureConfig:
    """The standing posture."""

    knee: Positive  # bend of the knees from the stretched leg [rad]
    knee_least: Positive  # the same of knees with little torque [rad]
    torque_share: Fraction  # of a knee's torque limit that standing on one leg may take [-]
    gap: Positive  # least distance between the inner edges of the soles [m]
    margin: Fraction  # distance of every joint from its limits, over its range [-]
    level: Positive  # largest tilt of a sole that counts as flat [rad]
    residual: Positive  # largest miss of a position [m]
    # Wrist from the shoulder over the arm's length: ahead, outward, up [-].
    hands: Annotated[tuple[tuple[float, float, float], ...], Field(min_length=1)]


@dataclass(frozen=True, slots=True, config=STRICT)
class ProposalConfig:
    """All assumptions of a proposal."""

    repair: RepairConfig
    sole: SoleConfig
    drive: DriveConfig
    posture: PostureConfig
