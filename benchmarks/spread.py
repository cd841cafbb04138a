"""How samples are spread: what a case keeps of them in their place, and percentiles over several cases."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.timed_run import QUANTILES
from models.types import Vector

Spread = dict[str, Any]
"""``count`` of the samples, and their ``quantiles`` at ``QUANTILES``; plain values, for a case."""


def spread(samples: ArrayLike) -> Spread:
    """What is kept of some samples (n,); NaN where there is none."""
    values = np.asarray(samples, dtype=np.float64)
    found = np.percentile(values, QUANTILES) if values.size else np.full(len(QUANTILES), np.nan)
    return {"count": int(values.size), "quantiles": found.tolist()}


def percentiles_of(spreads: Sequence[Spread], percents: Sequence[float] = QUANTILES) -> Vector:
    """Percentiles of all the samples together.

    Exact at ``QUANTILES`` for one spread. The samples of several are taken for evenly spread between two quantiles of
    theirs.

    Args:
        spreads: Of ``spread``.
        percents: Which ones (k,) [%].

    Returns:
        The percentiles (k,), in the unit of the samples; NaN where there is no sample.
    """
    held = [each for each in spreads if each["count"]]
    if not held:
        return np.full(len(percents), np.nan)
    if len(held) == 1:
        return np.asarray(np.interp(percents, QUANTILES, held[0]["quantiles"]))
    values = np.unique(np.concatenate([each["quantiles"] for each in held]))
    below = [each["count"] * np.interp(values, each["quantiles"], QUANTILES) for each in held]
    return np.asarray(np.interp(percents, np.sum(below, axis=0) / sum(each["count"] for each in held), values))


def spread_of(case: dict[str, Any], name: str) -> Spread | None:
    """What a case keeps of some samples; reports from before spreads hold the samples themselves. None for nothing."""
    kept: Spread | None = case.get("spreads", {}).get(name)
    if kept is None and name in case:
        kept = spread(case[name])
    return kept
