"""Motions that a calibration needs, kept apart from those that a user may ask for."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path


def calibration_motions() -> tuple[Path, ...]:
    """Files for the ``extra`` of ``MotionPlanner``: 'calibrate_joints' and 'calibrate_feet'."""
    return tuple(sorted((Path(str(files("planners"))) / "motions" / "calibration").glob("*.yaml")))
