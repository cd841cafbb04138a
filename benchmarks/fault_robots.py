"""Robots whose profile or description is wrong."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import yaml

from benchmarks.fault_rows import LoopChanges
from models.config import read_yaml
from models.profile import load_profile
from models.robot_model import RobotModel
from models.urdf import resolve_uri


def robot_of(name: str, changes: LoopChanges, folder: Path) -> RobotModel:
    """Load a robot as a row wants it.

    Args:
        name: Of its profile.
        changes: What is wrong with it.
        folder: For the files that are changed.

    Raises:
        PoiseError: It cannot be loaded.
    """
    if not changes.profile and changes.described_mass == 1.0:
        return RobotModel.load(name)
    source = Path(load_profile(name).source)
    profile = _merged(read_yaml(source), changes.profile)
    file, urdf = folder / "profile.yaml", folder / "robot.urdf"
    description = ET.parse(resolve_uri(str(profile["urdf"]), source.parent))
    description.write(urdf)
    file.write_text(yaml.safe_dump({**profile, "urdf": str(urdf)}), encoding="utf-8")
    robot = RobotModel.load(file)
    for mass in description.getroot().findall("link/inertial/mass")[:1]:
        mass.set("value", str(changes.described_mass * float(mass.attrib["value"])))
    description.write(urdf)
    return robot


def _merged(given: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """A mapping with changes, those of mappings in it likewise."""
    merged = dict(given)
    for key, value in changes.items():
        merged[key] = _merged(given.get(key, {}), value) if isinstance(value, dict) else value
    return merged
