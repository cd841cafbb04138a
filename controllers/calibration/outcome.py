"""What a calibration answers."""

from __future__ import annotations

from dataclasses import dataclass

from models.calibration import Calibration
from models.types import CommandReply, Vector

AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Answer of a calibration.

    Attributes:
        reply: Whether it succeeded, why not or what was found, and the numbers.
        calibration: The new calibration, or None when it was refused.
    """

    reply: CommandReply
    calibration: Calibration | None = None


def refuse(reason: str, details: dict[str, float]) -> Outcome:
    """A refusal with its numbers."""
    return Outcome(CommandReply(False, reason, details))


def accept(reason: str, details: dict[str, float], calibration: Calibration) -> Outcome:
    """A success with its numbers."""
    return Outcome(CommandReply(True, reason, details), calibration)


def named(name: str, values: Vector) -> dict[str, float]:
    """A vector (3,) as details ``name_x``, ``name_y``, ``name_z``."""
    return {f"{name}_{axis}": float(value) for axis, value in zip(AXES, values, strict=True)}
