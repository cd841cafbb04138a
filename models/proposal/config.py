"""Schema of ``models/config/proposal.yaml``: what a proposal assumes of a robot whose URDF does not say."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT

Positive = Annotated[float, Field(gt=0.0)]
Share = Annotated[float, Field(gt=0.0, lt=1.0)]


@dataclass(frozen=True, slots=True, config=STRICT)
class RepairConfig:
    """Joints of a URDF that says too little.

    Attributes:
        torque: Torque limit where there is none, over mass, gravity and the length of the longest chain [-].
        velocity: Velocity limit where there is none [rad/s].
        range: Position limits where there are none, to both sides [rad].
        light: Mass moved by a joint without torque below which the joint is held fixed, over the robot's mass [-].
    """

    torque: Positive
    velocity: Positive
    range: Positive
    light: Share


@dataclass(frozen=True, slots=True, config=STRICT)
class SoleConfig:
    """Soles from the shapes of the feet.

    Attributes:
        mirror: Largest distance of a joint from the mirror image of its partner [m].
        band: Height above the lowest point of a foot up to which its points belong to the sole [m].
        inset: Taken off every side of a sole whose outline is a mesh or a box [m].
        length_min: Shortest sole that a robot can stand on, over the length of the leg [-].
        width_min: Narrowest such sole, over the length of the leg [-].
        lopsided: Ratio of the sole's two overhangs of the ankle from which on the longer one is the toe [-].
        ankle: Height of an ankle without any shape below it, over the length of the leg [-].
        heel: Where such a foot begins behind the ankle, over the length of the leg [-].
        toe: Where it ends ahead of the ankle [-].
        half_width: Half its width [-].
        friction: Coulomb coefficient of sole on floor [-].
    """

    mirror: Positive
    band: Positive
    inset: Annotated[float, Field(ge=0.0)]
    length_min: Positive
    width_min: Positive
    lopsided: Annotated[float, Field(gt=1.0)]
    ankle: Positive
    heel: Positive
    toe: Positive
    half_width: Positive
    friction: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class DriveConfig:
    """Drives by mass m, height h of the CoM, and torque limit tau; see ``models/proposal/drives.py``.

    Attributes:
        armature_torque: Rotor inertia over tau h / g [-].
        armature_min: Least rotor inertia over m h^2 [-].
        armature_max: Largest rotor inertia over m h^2 [-].
        friction: Largest viscous (at 1 rad/s) and dry friction over tau [-].
        rise: Time in which the torque rises to its limit [s].
        stiffness: kp over sqrt(tau m g h) [1/rad].
        damping_time: kd / kp over sqrt(h / g) [-].
        damping_max: kd over inertia per tick of the drivers [-].
        tick: Tick of the drivers [s].
    """

    armature_torque: Positive
    armature_min: Positive
    armature_max: Positive
    friction: Positive
    rise: Positive
    stiffness: Positive
    damping_time: Positive
    damping_max: Positive
    tick: Positive


@dataclass(frozen=True, slots=True, config=STRICT)
class PostureConfig:
    """The standing posture.

    Attributes:
        knee: How far the knees are bent from the stretched leg [rad].
        gap: Least distance between the inner edges of the soles [m].
        margin: Distance of every joint from its limits, over its range [-].
        level: Largest tilt of a sole that counts as flat [rad].
        residual: Largest miss of a position [m].
        hands: Where the wrist may be from the shoulder over the arm's length: ahead, outward, up [-].
    """

    knee: Positive
    gap: Positive
    margin: Share
    level: Positive
    residual: Positive
    hands: Annotated[tuple[tuple[float, float, float], ...], Field(min_length=1)]


@dataclass(frozen=True, slots=True, config=STRICT)
class ProposalConfig:
    """Everything that a proposal assumes."""

    repair: RepairConfig
    sole: SoleConfig
    drive: DriveConfig
    posture: PostureConfig
