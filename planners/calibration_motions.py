"""Motions that a calibration needs, kept apart from the packaged ones: not every planner knows them."""

from __future__ import annotations

from collections.abc import Container
from importlib.resources import files
from pathlib import Path


def calibration_motions() -> tuple[Path, ...]:
    """Files for the ``extra`` of ``MotionPlanner``: 'calibrate_joints' and 'calibrate_feet'."""
    return tuple(sorted((Path(str(files("planners"))) / "motions" / "calibration").glob("*.yaml")))


def variant(motion: str, robot: str, names: Container[str]) -> str:
    """A robot's own version of a motion, ``<motion>_<robot>``, where there is one among the names."""
    own = f"{motion}_{robot}"
    return own if own in names else motion
