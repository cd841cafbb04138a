"""Words of the topic ``mode``."""

from __future__ import annotations

from models.errors import MessageError
from models.types import Mode

MODES = {mode.value: mode for mode in Mode}
"""Mode by its word."""


def mode_named(word: str) -> Mode:
    """Mode of a word.

    Raises:
        MessageError: It is unknown; the known ones are listed.
    """
    if word not in MODES:
        raise MessageError(f"unknown mode '{word[:32]}'; known: {', '.join(MODES)}")
    return MODES[word]
