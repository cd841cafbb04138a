"""Drives that fit a robot of this mass and height, where its maker says nothing of them.

With mass m, height h of the CoM, gravity g and the torque limit tau of a joint,

    armature = clip(a tau h / g, a_min m h^2, a_max m h^2)       kp = k sqrt(tau m g h)      kd = T sqrt(h / g) kp

so that robots of one shape and of different sizes behave alike (all terms scale with mass and length as they must).
a, k and T lie between those of the G1 and of TALOS. kd stays below c I / dt, with the inertia I = 1 / (M^-1)_ii that
the joint feels and the tick dt of its driver: beyond, the sampled velocity gain of a light wrist rings.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from models.constants import GRAVITY
from models.profile import Joint, Motor
from models.proposal.config import DriveConfig
from models.proposal.findings import Finding, named
from models.proposal.skeleton import BASE, Skeleton
from models.types import Vector


def propose_drives(
    skeleton: Skeleton, height: float, config: DriveConfig
) -> tuple[dict[str, Motor], dict[str, Joint], list[Finding]]:
    """A motor for every joint; partners share one.

    Args:
        skeleton: The joints.
        height: Of the CoM above the soles [m].
        config: The scales.

    Returns:
        Motors by name, joints by name, and joints whose friction in the URDF is no friction of a drive.
    """
    model = skeleton.model
    mass = float(pin.computeTotalMass(model))
    bare = _felt_inertia(skeleton)
    motors: dict[str, Motor] = {}
    joints: dict[str, Joint] = {}
    sticky: list[str] = []
    for j in range(BASE + 1, model.njoints):
        v = int(model.joints[j].idx_v)
        twin = skeleton.partners.get(j, j)
        if skeleton.name(twin) in joints and model.effortLimit[v] == model.effortLimit[int(model.joints[twin].idx_v)]:
            joints[skeleton.name(j)] = joints[skeleton.name(twin)]
            continue
        torque = float(model.effortLimit[v])
        weight = mass * GRAVITY * height
        effective = min(torque, weight)  # some URDFs write 1000 N.m for "plenty"
        armature = float(
            np.clip(
                config.armature_torque * effective * height / GRAVITY,
                config.armature_min * mass * height**2,
                config.armature_max * mass * height**2,
            )
        )
        decay = config.damping_time * np.sqrt(height / GRAVITY)
        stiffness = config.stiffness * np.sqrt(effective * weight)
        damping = min(decay * stiffness, config.damping_max * (float(bare[v]) + armature) / config.tick)
        cap = config.friction * effective
        viscous, dry = float(model.damping[v]), float(model.friction[v])
        if viscous > cap or dry > cap:
            sticky.append(skeleton.name(j))
        motor = Motor(
            armature=_rounded(armature),
            damping=_rounded(min(viscous, cap) if viscous > 0.0 else 0.5 * cap),
            frictionloss=_rounded(min(dry, cap) if dry > 0.0 else 0.5 * cap),
            torque_rate=_rounded(torque / config.rise),
            kp=_rounded(damping / decay),
            kd=_rounded(damping),
        )
        joints[skeleton.name(j)] = Joint(motor=_filed(motors, motor, torque))
    findings = []
    if sticky:
        text = f"damping or friction above {100.0 * config.friction:g} % of the torque limit: no figure of a drive"
        findings.append(Finding("note", named("joint", sticky), text, "cut down to that"))
    return motors, joints, findings


def _felt_inertia(skeleton: Skeleton) -> Vector:
    """Inertia that each velocity coordinate feels with all others free, without rotors (nv,) [kg.m^2]."""
    model = skeleton.model
    data = model.createData()
    upper = np.triu(pin.crba(model, data, pin.neutral(model)))
    return np.asarray(1.0 / np.diag(np.linalg.inv(upper + np.triu(upper, 1).T)))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _filed(motors: dict[str, Motor], motor: Motor, torque: float) -> str:
    """Name of a motor, entered unless an equal one is there."""
    for name, known in motors.items():
        if known == motor:
            return name
    stem = name = f"drive_{torque:g}nm".replace(".", "p").replace("+", "")
    letter = ord("b")
    while name in motors:
        name = f"{stem}_{chr(letter)}"
        letter += 1
    motors[name] = motor
    return name
