"""What every plant offers, simulated or real: reset, read, write, close."""

from __future__ import annotations

from typing import Protocol

from models.types import SensorData, Vector


class Plant(Protocol):
    """A robot seen from its motor drivers: measurements out, joint torques in.

    Attributes:
        t: Time on the plant's own clock [s].
        period: Time between two of its ticks [s].
    """

    @property
    def t(self) -> float:
        """Time on the plant's own clock [s]."""
        ...

    @property
    def period(self) -> float:
        """Time between two ticks [s]."""
        ...

    def reset(self) -> None:
        """Bring the robot to its start, without torque."""
        ...

    def read(self) -> SensorData:
        """Measurements of this tick; reading twice in a tick gives the same."""
        ...

    def write(self, tau: Vector) -> None:
        """Set the joint torques (nj,) [N.m] that act until the next call."""
        ...

    def close(self) -> None:
        """Take the torque away and let go of the robot or simulator."""
        ...
