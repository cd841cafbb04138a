"""Schema of ``controllers/config/arbitration.yaml``."""

from __future__ import annotations

import re
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from models.config import STRICT

PLAIN = "plain"
"""Source of ``humanoid_commands`` and ``cmd_vel``, which everybody knows."""

_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, slots=True, config=STRICT)
class SourceConfig:
    """A source of commands."""

    priority: Annotated[int, Field(ge=0, le=255, description="The higher one is in command; no two share one")]
    timeout: Annotated[float, Field(gt=0, le=10, description="Silence after which it is no longer in command [s]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class LockConfig:
    """A lock on sources."""

    priority: Annotated[int, Field(ge=0, le=256, description="Sources below this priority are silenced")]
    timeout: Annotated[float, Field(ge=0, le=10, description="Silence after which it locks by itself; 0: never [s]")]


@dataclass(frozen=True, slots=True, config=STRICT)
class ArbitrationConfig:
    """Who may command the robot."""

    sources: Annotated[dict[str, SourceConfig], Field(description="By name, as in the topic commands/<name>")]
    locks: Annotated[dict[str, LockConfig], Field(description="By name, as in the topic locks/<name>")]

    def __post_init__(self) -> None:
        for name in (*self.sources, *self.locks):
            if not _NAME.fullmatch(name):
                raise ValueError(f"'{name}' is no part of a topic's name: lower-case letters, digits and _ only")
        if PLAIN not in self.sources:
            raise ValueError(f"sources: '{PLAIN}' is missing")
        priorities = [source.priority for source in self.sources.values()]
        if len(set(priorities)) < len(priorities):
            raise ValueError("sources: two have the same priority")
