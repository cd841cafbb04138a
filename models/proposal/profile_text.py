"""Writes a proposed profile as commented YAML, and its repaired URDF."""

import xml.etree.ElementTree as ET
from dataclasses import asdict, replace
from pathlib import Path
from textwrap import fill
from typing import Any

import yaml

from models.config import descriptions
from models.errors import ConfigError
from models.profile import EncoderSensor, FootSensor, ImuSensor, Latency
from models.proposal.propose import Proposal

_WIDTH = 120  #: Maximum line length of a comment
_TEXT = """\
# {name}: proposed by `poise check-robot` from {urdf}.
# {mass:.1f} kg, CoM {com:.3f} m above the soles, legs of {leg:.3f} m. Everything below that is not in the URDF is an
# assumption: see the findings, then enter the manufacturer's data.
{findings}name: {name}
urdf: {file}
base_link: {base_link}

# Drives, scaled from those of the G1 and TALOS by mass, height and torque limit. armature: rotor inertia behind the
# gear [kg.m^2]; damping [N.m.s/rad], frictionloss [N.m]; torque_rate [N.m/s]; kp [N.m/rad], kd [N.m.s/rad].
motors:
{motors}
# Torque and velocity limits are the URDF's unless torque_limit [N.m] or velocity_limit [rad/s] is given here.
joints:
{joints}
# Sole frames under the ankles, x forward, z up; rectangles x_min, x_max, y_min, y_max from the shapes of the feet [m].
feet:
{feet}  friction: {friction}  # rubber on a hard floor [-]

# Names of REP-120 on links; xyz [m] and rpy [rad] in the link, those of gaze and imu with the axes of the base at zero.
frames:
{frames}
# Knees slightly bent, soles flat, CoM above their middle [rad].
postures:
  stand:
{stand}
# The G1's sensors, those of the feet scaled by the weight: replace them by those of your data sheets.
sensors:
{sensors}"""
_HULLS = """
# Capsules within the bounds of the links (link frame) [m], against the floor only.
hulls:
"""


def write_proposal(proposal: Proposal, path: Path) -> list[Path]:
    """Write the profile and, if it was repaired, the URDF beside it; returns the files, profile first.

    Raises ``ConfigError`` if the repaired URDF would overwrite its source.
    """
    if proposal.robot is not None:
        file = f"{path.stem}_repaired.urdf"
        if (path.parent / file).resolve() == proposal.source:
            raise ConfigError(f"{proposal.source}: its repaired copy would overwrite it: give another file with --out")
        proposal = replace(proposal, profile=replace(proposal.profile, urdf=file))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(profile_text(proposal), encoding="utf-8")
    written = [path]
    if proposal.robot is not None:
        tree = ET.ElementTree(proposal.robot)
        ET.indent(tree)
        written.append(path.parent / proposal.profile.urdf)
        tree.write(written[-1], encoding="utf-8", xml_declaration=True)
    return written


def profile_text(proposal: Proposal) -> str:
    """Profile as YAML with comments and units, readable by ``models.profile.load_profile``."""
    profile = proposal.profile
    data: dict[str, Any] = asdict(profile)
    findings = "".join(
        fill(
            f"{f.severity}: {f.culprit}: {f.fault}: {f.remedy}", _WIDTH, initial_indent="# - ", subsequent_indent="#   "
        )
        + "\n"
        for f in proposal.findings
    )
    feet, sensors = data["feet"], data["sensors"]
    schemas = {"imu": ImuSensor, "encoders": EncoderSensor, "feet": FootSensor, "latency": Latency}
    text = _TEXT.format(
        name=_flow(profile.name),
        urdf=proposal.source.name,
        file=_flow(profile.urdf),
        base_link=_flow(profile.base_link),
        mass=proposal.mass,
        com=proposal.com_height,
        leg=proposal.leg_length,
        findings=findings,
        feet=_rows({"left": feet["left"], "right": feet["right"]}),
        friction=feet["friction"],
        stand="".join(f"    {_flow(name)}: {value}\n" for name, value in data["postures"]["stand"].items()),
        sensors="".join(f"  {key}:\n{_described(sensors[key], schema)}" for key, schema in schemas.items()),
        **{key: _rows(data[key]) for key in ("motors", "joints", "frames")},
    )
    return text + (_HULLS + _rows(data["hulls"]) if data["hulls"] else "")


def _flow(value: Any) -> str:
    plain = yaml.safe_dump(_plain(value), default_flow_style=True, sort_keys=False, width=10**6)
    return plain.removesuffix("\n").removesuffix("\n...")


def _plain(value: Any) -> Any:
    """Plain data without None and without zero ``xyz`` and ``rpy``."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items() if v is not None and not (k in ("xyz", "rpy") and not any(v))}
    return list(value) if isinstance(value, tuple) else value


def _rows(entries: dict[str, Any]) -> str:
    return "".join(f"  {_flow(name)}: {_flow(entry)}\n" for name, entry in entries.items())


def _described(values: dict[str, Any], schema: type) -> str:
    texts = descriptions(schema)
    lines = (f"    {key}: {_flow(value)}  # {texts[key]}\n" for key, value in values.items() if value is not None)
    return "".join(lines)
