r"""Robust loss of a candidate, and a race that measures only the necessary scenarios of a generation.

The loss is the conditional value at risk over sectors:

.. math:: L = \text{mean of the largest } \lceil \alpha n \rceil \text{ of } \ell_1, \dots, \ell_n

where ``l_i`` is the mean loss of a sector of a kind of scenarios, and ``alpha`` is the ``tail``. All losses are
non-negative, so ``L`` with 0 for every scenario that is not measured is a lower bound ``L_b``.

``race`` measures blocks of scenarios of the ``mu`` candidates with the smallest ``L_b`` (initially all 0), until these
candidates are measured completely. Then no other candidate can be among the best ``mu``, whatever its losses in its
remaining scenarios, which are skipped.

Exact results, as if all scenarios were measured: the best ``mu`` candidates, their losses and their order, including
ties. CMA-ES computes mean, step size and evolution paths from them only. The order of the other candidates, by ``L_b``,
is not exact. The ``cmaes`` package gives them negative weights by rank (active CMA-ES). The covariance update may
differ in how much it shrinks along the directions of bad candidates, but not in which candidates are bad.

The next scenarios depend only on losses, not on when they arrive. Therefore the measurements are the same for any
number of workers, and for a search that is resumed.

References:
    Rockafellar, Uryasev: Optimization of conditional value-at-risk, 2000; Hansen: The CMA evolution strategy: a
    tutorial, arXiv 1604.00772.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.core.harness import Case
from models.types import Matrix

Group = tuple[str, int]  #: Kind and sector
#: Returns the losses for pairs of indices of candidate and scenario
Measure = Callable[[Sequence[tuple[int, int]]], Sequence[float]]


def group_of(case: Case) -> Group:
    """Return kind and sector of a scenario."""
    return case["kind"], case["sector"]


def robust_loss(scenarios: Sequence[Case], losses: Sequence[float], tail: float) -> float:
    """Return the mean loss of the worst share ``tail`` of the groups by kind and sector."""
    groups: dict[Group, list[float]] = {}
    for scenario, loss in zip(scenarios, losses, strict=True):
        groups.setdefault(group_of(scenario), []).append(loss)
    worst = sorted((float(np.mean(each)) for each in groups.values()), reverse=True)
    return float(np.mean(worst[: math.ceil(tail * len(worst))]))


@dataclass(frozen=True, slots=True)
class Raced:
    """Losses of the candidates of a generation."""

    losses: list[float]  #: Loss per candidate; a lower bound if scenarios were skipped [-]
    table: Matrix  #: Loss per candidate and scenario, NaN if skipped (candidates, scenarios) [-]

    @property
    def complete(self) -> list[bool]:
        """Whether all scenarios of each candidate were measured."""
        return [not np.isnan(row).any() for row in self.table]


def race(
    scenarios: Sequence[Case],
    candidates: int,
    best: int,
    tail: float,
    block: int,
    measure: Measure,
    expected: Mapping[Group, float] | None = None,
) -> Raced:
    """Return losses of the candidates, exact for the ``best`` ones; see the docstring of the module.

    The hardest scenarios come first, so that bad candidates are detected early. The hardness is the mean over the
    measured losses of the scenario and the ``expected`` loss of its group.
    """
    table = np.full((candidates, len(scenarios)), np.nan)
    prior = np.array([(expected or {}).get(group_of(each), 0.0) for each in scenarios])
    while True:
        losses = [robust_loss(scenarios, row, tail) for row in np.nan_to_num(table)]
        ranked = sorted(range(candidates), key=lambda k: (losses[k], k))
        left = [k for k in ranked[:best] if np.isnan(table[k]).any()]
        if not left and losses[ranked[0]] == losses[ranked[-1]]:  # equal losses decide whether CMA-ES is updated
            left = [k for k in ranked if np.isnan(table[k]).any()]
        if not left:
            return Raced(losses, table)
        hardness = (prior + np.nansum(table, axis=0)) / (1 + (~np.isnan(table)).sum(axis=0))
        order = np.argsort(-hardness, kind="stable")
        asked = [(k, int(j)) for k in left for j in [j for j in order if np.isnan(table[k, j])][:block]]
        for (k, j), loss in zip(asked, measure(asked), strict=True):
            if not loss >= 0.0:
                raise ValueError(f"loss {loss} of candidate {k} in scenario {j}: 0 or more expected")
            table[k, j] = loss
