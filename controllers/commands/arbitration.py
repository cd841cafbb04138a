"""Arbitration of command sources with priorities, timeouts and locks, as in twist_mux; also for text commands."""

import dataclasses
import math
import re
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT, default_config
from models.errors import CommandError
from models.types import STILL, Velocity

PLAIN = "plain"  #: Source of the topics ``humanoid_commands`` and ``cmd_vel``
_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, slots=True, config=STRICT)
class SourceConfig:
    """A source of commands."""

    priority: Annotated[int, Field(ge=0, le=255)]  #: Unique; the highest active source is in command
    timeout: Annotated[float, Field(gt=0, le=10)]  #: Silence after which the source is no longer in command [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class LockConfig:
    """A lock on sources."""

    priority: Annotated[int, Field(ge=0, le=256)]  #: Sources below this priority are locked out
    timeout: Annotated[float, Field(ge=0, le=10)]  #: Silence after which the lock closes; 0: never [s]


@dataclass(frozen=True, slots=True, config=STRICT)
class ArbitrationConfig:
    """Command sources and locks."""

    sources: dict[str, SourceConfig]  #: By name, as in the topic commands/<name>
    locks: dict[str, LockConfig]  #: By name, as in the topic locks/<name>

    def __post_init__(self) -> None:
        for name in (*self.sources, *self.locks):
            if not _NAME.fullmatch(name):
                raise ValueError(f"'{name}' is not valid in a topic name: use lower-case letters, digits and _ only")
        if PLAIN not in self.sources:
            raise ValueError(f"sources: '{PLAIN}' is missing")
        priorities = [source.priority for source in self.sources.values()]
        if len(set(priorities)) < len(priorities):
            raise ValueError("sources: two have the same priority")


NO_SOURCE = "none"  #: Name returned when no source is in command


@dataclasses.dataclass(slots=True)
class _Source:
    velocity: Velocity = STILL
    until: float = -math.inf  # expiry [s]


class Arbiter:
    """Arbitrates velocities that must be repeated, and text commands, from several sources.

    The source with the highest priority whose last command has not expired is in command, and its velocity applies.
    Meanwhile text commands of lower sources are refused; their velocities apply again, if not expired, when the higher
    source times out. A velocity set by a text command, such as ``forward``, holds until a source of at least the same
    priority sends another command. A lock locks out the sources below its priority.

    Times [s] are arguments (there is no clock) and decrease only with ``restart``. ``config`` defaults to the packaged
    ``controllers/config/arbitration.yaml``.

    References:
        S. Magnenat et al., twist_mux: multiplexer of velocity commands with priorities, timeouts and locks (ROS).
    """

    def __init__(self, config: ArbitrationConfig | None = None) -> None:
        self.config = default_config(ArbitrationConfig, "controllers", "arbitration") if config is None else config
        self._order = sorted(self.config.sources, key=lambda name: -self.config.sources[name].priority)
        self._locked = dict.fromkeys(self.config.locks, False)
        self._updated = dict.fromkeys(self.config.locks, -math.inf)
        self.forget()

    def restart(self) -> None:
        """Handle a clock that has gone back: discard all commands; locks with a timeout close."""
        self._updated = dict.fromkeys(self._updated, -math.inf)
        self.forget()

    def forget(self) -> None:
        """Discard all commands; locks stay."""
        self._commands = {name: _Source() for name in self._order}

    def require(self, source: str, t: float) -> None:
        """Raise ``CommandError`` unless a source may send a text at time t [s]; names the lock or the higher source."""
        self._require_open(source, t)
        above = self.in_command(t)
        if above != NO_SOURCE and self._priority(above) > self._priority(source):
            raise CommandError(f"'{source}' is not in command: '{above}' is")

    def executed(self, source: str, t: float) -> None:
        """Record that a text command was executed at time t [s]: its source is in command until the timeout."""
        command = self._commands[source]
        command.until = max(command.until, t + self.config.sources[source].timeout)

    def hold(self, source: str, velocity: Velocity) -> None:
        """Hold a velocity set by a text command; discards earlier commands of this source and lower sources."""
        self._forget_below(source, 0.0)
        self._commands[source] = _Source(velocity, math.inf)

    def repeat(self, source: str, velocity: Velocity, t: float) -> None:
        """Accept a velocity that must be repeated within a timeout; ``CommandError`` if locked out or not finite."""
        self._require_open(source, t)
        if not all(math.isfinite(value) for value in velocity):
            raise CommandError(f"velocity {velocity} of '{source}' is not finite")
        self._forget_below(source, math.inf)
        self._commands[source] = _Source(velocity, t + self.config.sources[source].timeout)

    def lock(self, name: str, locked: bool, t: float) -> None:
        """Close or open a lock; ``CommandError`` if it is unknown."""
        if name not in self._locked:
            raise CommandError(f"unknown lock '{name}'; known: {', '.join(self._locked)}")
        self._locked[name], self._updated[name] = locked, t

    def locks(self, t: float) -> tuple[str, ...]:
        """Names of the locks that are closed at time t [s], by command or by timeout."""
        return tuple(name for name in self._locked if self._closed(name, t))

    def in_command(self, t: float) -> str:
        """The source in command at time t [s]; ``NO_SOURCE`` if all are expired or locked out."""
        below = max((self.config.locks[name].priority for name in self.locks(t)), default=-1)
        for name in self._order:
            if self._commands[name].until >= t and self._priority(name) >= below:
                return name
        return NO_SOURCE

    def velocity(self, t: float) -> Velocity:
        """Velocity of the source in command at time t [s]; zero if there is none."""
        name = self.in_command(t)
        return STILL if name == NO_SOURCE else self._commands[name].velocity

    def _forget_below(self, source: str, until: float) -> None:
        """Discard commands of this source and lower sources that expire at ``until`` [s] or later."""
        for name in self._order:
            if self._priority(name) <= self._priority(source) and self._commands[name].until >= until:
                self._commands[name] = _Source()

    def _priority(self, source: str) -> int:
        return self.config.sources[source].priority

    def _closed(self, name: str, t: float) -> bool:
        timeout = self.config.locks[name].timeout
        return self._locked[name] or (timeout > 0.0 and t - self._updated[name] > timeout)

    def _require_open(self, source: str, t: float) -> None:
        if source not in self._commands:
            raise CommandError(f"unknown source '{source[:32]}'; known: {', '.join(self._order)}")
        for name in self.locks(t):
            if self._priority(source) < self.config.locks[name].priority:
                raise CommandError(f"'{source}' is locked out by '{name}'")
