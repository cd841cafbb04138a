"""Search of the largest disturbance that is survived."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from models.config import STRICT

Positive = Annotated[float, Field(gt=0.0)]


@schema(frozen=True, slots=True, config=STRICT)
class Search:
    """How the largest value that holds is looked for; all in the unit of that value.

    Attributes:
        first: Tried first.
        largest: None larger is tried.
        stride: Step of the search for the bracket.
        resolution: Width of the bracket at which the bisection ends.
    """

    first: Positive
    largest: Positive
    stride: Positive
    resolution: Positive


def largest(holds: Callable[[float], bool], search: Search) -> tuple[float, int]:
    """Bracket and bisect the largest value that holds; the values tried below it, on the way, held as well.

    Args:
        holds: Whether a value holds.
        search: Limits.

    Returns:
        The value, 0 when none holds, and how many were tried.
    """
    low, high, value, tried = 0.0, math.inf, search.first, 0
    while high - low > search.resolution:
        tried += 1
        if holds(value):
            low = value
            if low >= search.largest:
                break
        else:
            high = value
        if math.isinf(high):
            value = min(low + search.stride, search.largest)
        elif low == 0.0:
            value = max(high - search.stride, 0.5 * high)
        else:
            value = 0.5 * (low + high)
    return low, tried
