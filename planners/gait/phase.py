"""Phases of the gait."""

from __future__ import annotations

from enum import Enum


class GaitPhase(Enum):
    """Phase of the gait."""

    STAND = "stand"
    START = "start"
    """Both feet; the weight moves to the first stance foot."""
    SINGLE = "single"
    DOUBLE = "double"
    """Both feet; the weight moves to the foot that has just landed."""
    FINISH = "finish"
    """Both feet; the weight returns to the middle."""
    LIFTED = "lifted"
    """In the air: nothing moves."""

    @property
    def stepping(self) -> bool:
        """Whether a foot is in the air or about to lift."""
        return self in (GaitPhase.START, GaitPhase.SINGLE, GaitPhase.DOUBLE)

    @property
    def resting(self) -> bool:
        """Whether the weight is between both feet, or on its way there."""
        return self in (GaitPhase.STAND, GaitPhase.FINISH)
