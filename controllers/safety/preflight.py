"""Checks before the robot may move: the messages must match the robot model of the controllers."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from controllers.safety.health import SupervisorConfig, tilt
from models.errors import RobotModelError
from models.robot_model import RobotModel
from models.types import Vector


@dataclass(frozen=True, slots=True)
class Evidence:
    """Observations of the robot; None where no message arrived."""

    description: str | None = None  # URDF that the robot publishes
    joints: Vector | None = None  # measured positions by the model's order (nj,) [rad]
    refusals: Mapping[str, str] = field(default_factory=dict)  # reasons of refused messages, by topic
    base_quaternion: Vector | None = None  # estimated orientation of B in W, xyzw (4,)
    rates: Mapping[str, float] = field(default_factory=dict)  # rate of each sensor topic, measured on its stamps [Hz]
    incompatible: Mapping[str, str] = field(default_factory=dict)  # endpoint and incompatible QoS policy, by topic


def preflight(
    model: RobotModel, config: SupervisorConfig, evidence: Evidence, nominal_rates: Mapping[str, float]
) -> tuple[str, ...]:
    """Findings that forbid arming, one sentence each; rates are checked for topics with ``nominal_rates`` [Hz] only."""
    return (
        *(f"{topic}: {reason}" for topic, reason in evidence.refusals.items()),
        *(f"'{topic}' has incompatible QoS: {who}" for topic, who in evidence.incompatible.items()),
        *_mass(model, config, evidence.description),
        *_joints(model, config, evidence.joints),
        *_attitude(config, evidence.base_quaternion),
        *_rates(config, evidence.rates, nominal_rates),
    )


def described_mass(urdf: str) -> float:
    """Total mass of a URDF [kg]; RobotModelError when the text is not XML, or a mass is not a number."""
    try:
        root = ET.fromstring(urdf)
        return sum(float(mass.attrib["value"]) for mass in root.iterfind("link/inertial/mass"))
    except (ET.ParseError, KeyError, ValueError) as error:
        raise RobotModelError(f"robot_description: {error}") from error


def _mass(model: RobotModel, config: SupervisorConfig, description: str | None) -> list[str]:
    if description is None:
        return ["robot_description was not received"]
    try:
        mass = described_mass(description)
    except RobotModelError as error:
        return [str(error)]
    expected = model.mass - model.profile.payload.mass
    if not abs(mass - expected) <= config.mass_tolerance * expected:  # a NaN fails, too
        return [f"robot_description weighs {mass:.2f} kg, the model '{model.name}' {expected:.2f} kg"]
    return []


def _joints(model: RobotModel, config: SupervisorConfig, joints: Vector | None) -> list[str]:
    if joints is None:
        return ["no joint states were received"]
    margin = config.limit_margin
    outside = np.flatnonzero(~((joints >= model.q_lower - margin) & (joints <= model.q_upper + margin)))
    return [
        f"joint '{model.joint_names[i]}' measures {joints[i]:.3f} rad, outside "
        f"[{model.q_lower[i]:.3f}, {model.q_upper[i]:.3f}]"
        for i in outside
    ]


def _attitude(config: SupervisorConfig, quaternion: Vector | None) -> list[str]:
    if quaternion is None:
        return ["no state estimate was received"]
    return attitude(config, tilt(quaternion))


def attitude(config: SupervisorConfig, angle: float) -> list[str]:
    """Findings that forbid arming at a base tilt [rad]; empty if it is allowed."""
    if not angle <= config.preflight_tilt:
        return [
            f"base tilted by {angle:.2f} rad: more than {config.preflight_tilt:.2f} rad, or its IMU is mounted wrong"
        ]
    return []


def _rates(config: SupervisorConfig, rates: Mapping[str, float], nominal: Mapping[str, float]) -> list[str]:
    found = []
    for topic, expected in nominal.items():
        rate = rates.get(topic, 0.0)
        if not abs(rate - expected) <= config.rate_tolerance * expected:
            found.append(f"{topic} arrives at {rate:.0f} Hz instead of {expected:.0f} Hz")
    return found
