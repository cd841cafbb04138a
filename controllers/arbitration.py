"""Who is in command: several sources with priorities, timeouts and locks, as in twist_mux; here for words too."""

from __future__ import annotations

import math
from dataclasses import dataclass

from controllers.arbitration_config import ArbitrationConfig
from models.config import default_config
from models.errors import CommandError

Velocity = tuple[float, float, float]
"""Walking velocity: forward [m/s], left [m/s], turn [rad/s]."""

STILL: Velocity = (0.0, 0.0, 0.0)

NOBODY = "nobody"
"""In command when no source is."""


@dataclass(slots=True)
class _Source:
    """What a source has said last.

    Attributes:
        velocity: That it wants.
        until: When that, and its command, runs out [s].
    """

    velocity: Velocity = STILL
    until: float = -math.inf


class Arbiter:
    """Velocities that must be repeated, and words, from several sources.

    The source of the highest priority whose last command has not run out is in command, and its velocity counts. While
    it is, words of lower sources are refused and their velocities wait: they count again, if still fresh, once it falls
    silent. A velocity that a word has set, such as that of ``forward``, holds until somebody of at least the word's
    priority says something else. A lock silences the sources below it.

    It has no clock: times [s] come in with the calls and never run backwards.

    Args:
        config: Sources and locks; the packaged ``controllers/config/arbitration.yaml`` when None.

    References:
        S. Magnenat et al., twist_mux: multiplexer of velocity commands with priorities, timeouts and locks (ROS).
    """

    def __init__(self, config: ArbitrationConfig | None = None) -> None:
        self.config = default_config(ArbitrationConfig, "controllers", "arbitration") if config is None else config
        self._order = sorted(self.config.sources, key=lambda name: -self.config.sources[name].priority)
        self._locked = dict.fromkeys(self.config.locks, False)
        self._heard = dict.fromkeys(self.config.locks, -math.inf)
        self.forget()

    def forget(self) -> None:
        """Forget what the sources have said; locks stay."""
        self._said = {name: _Source() for name in self._order}

    def require(self, source: str, t: float) -> None:
        """Refuse a word of a source that may not speak now.

        Args:
            source: Who speaks.
            t: Now [s].

        Raises:
            CommandError: The source is unknown or locked, or a higher one is in command; it is named.
        """
        self._require_open(source, t)
        above = self.in_command(t)
        if above != NOBODY and self._priority(above) > self._priority(source):
            raise CommandError(f"'{source}' is not in command: '{above}' is")

    def spoke(self, source: str, t: float) -> None:
        """A word of a source [at a time in s] has been carried out: it is in command."""
        said = self._said[source]
        said.until = max(said.until, t + self.config.sources[source].timeout)

    def hold(self, source: str, velocity: Velocity) -> None:
        """A word has set a velocity: it holds, and what its source and those below have said is forgotten."""
        for name in self._order:
            if self._priority(name) <= self._priority(source):
                self._said[name] = _Source()
        self._said[source] = _Source(velocity, math.inf)

    def repeat(self, source: str, velocity: Velocity, t: float) -> None:
        """Take a velocity that must be repeated within the source's timeout.

        Args:
            source: Who commands.
            velocity: Forward [m/s], left [m/s], turn [rad/s].
            t: Now [s].

        Raises:
            CommandError: The source is unknown or locked, or a value is not finite.
        """
        self._require_open(source, t)
        if not all(math.isfinite(value) for value in velocity):
            raise CommandError(f"velocity {velocity} of '{source}' is not finite")
        self._said[source] = _Source(velocity, t + self.config.sources[source].timeout)

    def lock(self, name: str, locked: bool, t: float) -> None:
        """A lock is closed or opened.

        Raises:
            CommandError: It is unknown.
        """
        if name not in self._locked:
            raise CommandError(f"unknown lock '{name}'; known: {', '.join(self._locked)}")
        self._locked[name], self._heard[name] = locked, t

    def locks(self, t: float) -> tuple[str, ...]:
        """Names of the locks that are closed now [s], by themselves or because they have fallen silent."""
        return tuple(name for name in self._locked if self._closed(name, t))

    def in_command(self, t: float) -> str:
        """The source in command now [s]; ``NOBODY`` when all are silent or locked."""
        below = max((self.config.locks[name].priority for name in self.locks(t)), default=-1)
        for name in self._order:
            if self._said[name].until >= t and self._priority(name) >= below:
                return name
        return NOBODY

    def velocity(self, t: float) -> Velocity:
        """Of the source in command now [s]; zero when nobody is."""
        name = self.in_command(t)
        return STILL if name == NOBODY else self._said[name].velocity

    def _priority(self, source: str) -> int:
        return self.config.sources[source].priority

    def _closed(self, name: str, t: float) -> bool:
        timeout = self.config.locks[name].timeout
        return self._locked[name] or (timeout > 0.0 and t - self._heard[name] > timeout)

    def _require_open(self, source: str, t: float) -> None:
        if source not in self._said:
            raise CommandError(f"unknown source '{source[:32]}'; known: {', '.join(self._order)}")
        for name in self.locks(t):
            if self._priority(source) < self.config.locks[name].priority:
                raise CommandError(f"'{source}' is locked out by '{name}'")
