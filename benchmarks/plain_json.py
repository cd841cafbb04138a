"""Cases as plain values, and the two ways in which files hold the numbers that JSON has no word for."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

WORDS = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
"""What stands in a JSON line for a number that JSON has no word for."""


def plain(value: Any) -> Any:
    """The value in dictionaries, lists, strings and Python's own numbers."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return value


def nulled(value: Any) -> Any:
    """A plain value with null for what JSON has no word for; ``with_nan`` cannot tell it from a null that was there."""
    return _each(value, lambda entry: None if _wordless(entry) else entry)


def with_nan(value: Any) -> Any:
    """A plain value with NaN for every null."""
    return _each(value, lambda entry: math.nan if entry is None else entry)


def worded(value: Any) -> Any:
    """A plain value with one of ``WORDS`` for what JSON has no word for; ``unworded`` takes it back."""
    return _each(value, lambda entry: _word(entry) if _wordless(entry) else entry)


def unworded(value: Any) -> Any:
    """What ``worded`` was given."""
    return _each(value, lambda entry: WORDS.get(entry, entry) if isinstance(entry, str) else entry)


def _wordless(value: Any) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


def _word(value: float) -> str:
    return "NaN" if math.isnan(value) else "Infinity" if value > 0.0 else "-Infinity"


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    """A plain value with every entry that holds no others changed."""
    if isinstance(value, dict):
        return {key: _each(entry, change) for key, entry in value.items()}
    if isinstance(value, list):
        return [_each(entry, change) for entry in value]
    return change(value)
