r"""The robust loss of a candidate, and a race that measures no more of the candidates of a generation than it must.

The loss is the conditional value at risk over sectors:

.. math:: L = \text{mean of the largest } \lceil \alpha n \rceil \text{ of } \ell_1, \dots, \ell_n

with ``l_i`` the mean loss of a sector of a kind of scenarios, and ``alpha`` the ``tail``. As no scenario has a loss
below 0, ``L`` with 0 for every scenario that is not measured is a lower bound ``L_b``.

``race`` measures blocks of scenarios of those ``mu`` candidates whose ``L_b`` is least (at first all are 0), until
these are measured in full. No other candidate can then get among the best ``mu``, whatever it does in the rest of its
scenarios, which are left out.

Exact, as if all were measured: the best ``mu`` candidates, their losses and their order, ties included. CMA-ES computes
mean, step size and evolution paths from them alone. Not exact: the order of the others, by ``L_b``. The ``cmaes``
package gives them negative weights by rank (active CMA-ES), so that the update of the covariance may differ in how much
the directions to bad candidates shrink, not in which candidates are bad.

What is measured next depends on losses alone, not on the time at which they arrive: any number of workers, and a
search that goes on, measure the same.

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
#: Losses of pairs of a candidate's and a scenario's index
Measure = Callable[[Sequence[tuple[int, int]]], Sequence[float]]


def group_of(case: Case) -> Group:
    """Kind and sector of a scenario."""
    return case["kind"], case["sector"]


def robust_loss(scenarios: Sequence[Case], losses: Sequence[float], tail: float) -> float:
    """Mean loss of the share ``tail`` of the groups by kind and sector, the worst ones."""
    groups: dict[Group, list[float]] = {}
    for scenario, loss in zip(scenarios, losses, strict=True):
        groups.setdefault(group_of(scenario), []).append(loss)
    worst = sorted((float(np.mean(each)) for each in groups.values()), reverse=True)
    return float(np.mean(worst[: math.ceil(tail * len(worst))]))


@dataclass(frozen=True, slots=True)
class Raced:
    """Losses of the candidates of a generation."""

    losses: list[float]  #: Of each candidate; a lower bound where scenarios were left out [-]
    table: Matrix  #: Of each candidate and scenario, NaN where left out (candidates, scenarios) [-]

    @property
    def complete(self) -> list[bool]:
        """Which candidates were measured in all scenarios."""
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
    """Losses of candidates, exact of the ``best`` ones; see the module.

    The hardest scenarios come first, so that a bad candidate shows early: by the mean of the losses of the candidates
    that have had it, and the ``expected`` loss of its group.
    """
    table = np.full((candidates, len(scenarios)), np.nan)
    prior = np.array([(expected or {}).get(group_of(each), 0.0) for each in scenarios])
    while True:
        losses = [robust_loss(scenarios, row, tail) for row in np.nan_to_num(table)]
        ranked = sorted(range(candidates), key=lambda k: (losses[k], k))
        left = [k for k in ranked[:best] if np.isnan(table[k]).any()]
        if not left and losses[ranked[0]] == losses[ranked[-1]]:  # whether all are equal decides if CMA-ES is updated
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
