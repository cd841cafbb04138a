"""Guard of a real robot: damps it when its driver is silent, because the robot keeps its last command."""

import numpy as np

SILENCE = 0.02  #: Time without a command of the driver after which the guard damps [s]


class SilenceGuard:
    """Measures the silence of the driver; a guard of one protocol receives its commands and makes damping ones.

    It has no effect before the driver's first command. ``active`` is whether the guard commands, ``interventions``
    counts how often it began to.
    """

    def __init__(self) -> None:
        self._last = -np.inf  # time of the driver's last command [s]
        self.active = False
        self.interventions = 0
        self.refused = 0  #: Messages that cannot be used
        self.strangers = 0  #: Commands of neither the driver nor a guard

    @property
    def armed(self) -> bool:
        """Whether the driver has commanded the robot."""
        return bool(self._last > -np.inf)

    def silence(self, now: float) -> float:
        """Time since the driver's last command at a time [s]."""
        return now - self._last

    def step(self, now: float) -> bytes | None:
        """The command to publish at a time [s]; None while the driver commands, or has not begun."""
        silent = self.armed and self.silence(now) > SILENCE
        if silent and not self.active:
            self.interventions += 1
        self.active = silent
        return self._damping_command(now) if silent else None

    def final_command(self) -> bytes | None:
        """The command that is left in force when the guard ends; None for the last damping one."""
        return None

    def _damping_command(self, now: float) -> bytes:
        raise NotImplementedError
