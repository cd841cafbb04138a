"""Which stamps something that has a rate is published at."""

from __future__ import annotations


class Due:
    """Divides the stamps into periods and says when another one has begun.

    Args:
        period: [ns]; 0 for every stamp.
        phase: When a period begins, as a share of it: what is published at the same rate shares no tick.
    """

    def __init__(self, period: int, phase: float = 0.0) -> None:
        self._period, self._shift = max(period, 1), round(phase * period)
        self._present = -1

    def __call__(self, stamp: int) -> bool:
        """Whether a period has begun since the last stamp [ns]."""
        before, self._present = self._present, (stamp - self._shift) // self._period
        return self._present != before
