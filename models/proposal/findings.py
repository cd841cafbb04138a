"""What was found amiss in a robot's description, whose it is, and what was done about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Severity = Literal["note", "wrong"]
"""'note': a gap that the proposal fills; 'wrong': the description contradicts itself or a robot that can stand."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a description.

    Attributes:
        severity: How bad it is.
        culprit: The joint, link or file, as in "joint 'left_knee'".
        fault: What is missing or wrong.
        remedy: What the proposal makes of it.
    """

    severity: Severity
    culprit: str
    fault: str
    remedy: str


def named(kind: str, names: Iterable[str]) -> str:
    """One or several joints or links, by name."""
    listed = list(names)
    return f"{kind}{'s' if len(listed) > 1 else ''} " + ", ".join(f"'{name}'" for name in listed)
