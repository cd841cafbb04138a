"""DCM reference of each phase of the gait: smooth within a phase, and from one phase to the next."""

from __future__ import annotations

import numpy as np

from models.types import Vector
from planners.gait import dcm
from planners.gait.footsteps import Foothold
from planners.gait.reaction import SwingReaction
from planners.gait.swing import SwingFoot


class DcmReference:
    """DCM and its rate, phase by phase.

    Args:
        reaction: Of the swing leg.

    Attributes:
        dcm: In W (2,) [m].
        rate: In W (2,) [m/s].
    """

    def __init__(self, reaction: SwingReaction) -> None:
        self._reaction = reaction
        self.dcm, self.rate = np.zeros(2), np.zeros(2)
        self._start = (self.dcm, self.rate)
        self._old = np.zeros(2)

    def reset(self, dcm_now: Vector) -> None:
        """Rest at a DCM (2,) [m]."""
        self.dcm, self.rate = dcm_now.copy(), np.zeros(2)
        self.begin_blend()

    def carry(self, way: Vector) -> None:
        """Move all of it (2,) [m]."""
        self.dcm, self._old = self.dcm + way, self._old + way
        self._start = self._start[0] + way, self._start[1]

    def zmp(self, omega: float) -> Vector:
        """ZMP that moves the reference (2,) [m]."""
        zmp: Vector = self.dcm - self.rate / omega
        return zmp

    def begin_blend(self) -> None:
        """Blends start from here and now."""
        self._start = (self.dcm, self.rate)

    def blend(self, end: Vector, rate: Vector, elapsed: float, duration: float) -> None:
        """On both feet, from where the blend began to a DCM (2,) [m] and rate (2,) [m/s]."""
        self.dcm, self.rate = dcm.blend(self._start, (end, rate), elapsed, duration)

    def single(self, point: Vector, end: Vector, swing: SwingFoot, target: Foothold, omega: float, left: float) -> None:
        """Single support.

        Args:
            point: ZMP point of the stance foot (2,) [m].
            end: DCM at the touchdown (2,) [m].
            swing: The swing foot's reference.
            target: Where it is to land.
            omega: [1/s].
            left: Time to touchdown [s].
        """
        self._old = point
        rest = self._reaction.rest(omega, left, swing, (target.x, target.y))
        offset = self._reaction.cmp_offset(swing)
        self.dcm, self.rate = dcm.single_support(point, end, omega, max(left, 0.0), rest, offset)

    def double(self, new: Vector, end: Vector, omega: float, elapsed: float, duration: float) -> None:
        """Double support, from the foot of the last single support to the new stance foot.

        Args:
            new: ZMP point of the new stance foot (2,) [m].
            end: DCM at the end of the double support (2,) [m].
            omega: [1/s].
            elapsed: Since the planned touchdown [s]; negative after an early one: the pendulum then still runs as in
                single support to where it was to be at the planned touchdown.
            duration: Of the double support [s].
        """
        self.dcm, self.rate = dcm.double_support(self._old, new, end, omega, max(elapsed, 0.0), duration)
        if elapsed < 0.0:
            self.dcm, self.rate = dcm.single_support(self._old, self.dcm, omega, -elapsed)
