"""The race of a generation: the best candidates are those of a full comparison, the others cost less."""

from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.core.harness import Case
from benchmarks.tuning.race import Group, Raced, group_of, race, robust_loss
from models.types import Matrix

BEST, TAIL = 3, 0.5


def scenarios(sectors: int, count: int) -> list[Case]:
    return [{"kind": "step", "sector": k} for _ in range(count) for k in range(sectors)]


class Bench:
    """Measures known losses, once each."""

    def __init__(self, losses: Matrix) -> None:
        self.losses, self.stages = losses, list[list[tuple[int, int]]]()
        self.measured: set[tuple[int, int]] = set()

    def __call__(self, pairs: Sequence[tuple[int, int]]) -> list[float]:
        assert pairs and not self.measured & set(pairs) and len(set(pairs)) == len(pairs)
        self.stages.append(list(pairs))
        self.measured |= set(pairs)
        return [float(self.losses[pair]) for pair in pairs]


def raced(losses: Matrix, cases: Sequence[Case], block: int = 2, expected: dict[Group, float] | None = None) -> Raced:
    return race(cases, len(losses), BEST, TAIL, block, Bench(losses), expected)


@pytest.mark.parametrize("block", [1, 3, 100])
def test_the_best_candidates_are_those_of_a_full_comparison(block: int) -> None:
    """Also with ties, candidates without a failure, and candidates that fail everywhere."""
    rng, cases = np.random.default_rng(0), scenarios(4, 2)
    left_out = 0
    for trial in range(200):
        rate = rng.uniform(0.0, 1.0, (8, 1)) ** (1 + trial % 3)
        losses = np.where(rng.random((8, 8)) < rate, rng.choice([1.0, 1.25, 1.5, 2.0], (8, 8)), 0.0)
        full = [robust_loss(cases, row, TAIL) for row in losses]
        found = raced(losses, cases, block)
        ranked = sorted(range(8), key=lambda k: (full[k], k))
        assert sorted(range(8), key=lambda k: (found.losses[k], k))[:BEST] == ranked[:BEST]
        for k in range(8):
            assert found.losses[k] == pytest.approx(full[k]) if found.complete[k] else found.losses[k] <= full[k]
        assert all(found.complete[k] for k in ranked[:BEST])
        assert (min(full) == max(full)) == (min(found.losses) == max(found.losses))
        known = ~np.isnan(found.table)
        np.testing.assert_array_equal(found.table[known], losses[known])
        left_out += int((~known).sum())
    assert left_out > (0.2 if block < 100 else 0.05) * 200 * 64


def test_a_hopeless_candidate_is_stopped_at_its_first_failures() -> None:
    cases = scenarios(8, 1)
    losses = np.zeros((6, 8))
    losses[:3, 7] = 1.0  # the best have the same failure
    losses[3:] = 2.0
    bench = Bench(losses)
    found = race(cases, 6, BEST, TAIL, 2, bench)
    assert found.complete == [True] * 3 + [False] * 3
    for k in range(3, 6):
        assert sum(pair[0] == k for pair in bench.measured) <= 2
        assert 0.25 < found.losses[k] < 2.0  # behind the best, by what is known


def test_hard_scenarios_come_first() -> None:
    """By earlier generations, then by what the others did in the same scenario."""
    cases = scenarios(8, 1)
    losses = np.zeros((4, 8))
    losses[:, 2] = 2.0
    bench = Bench(losses)
    race(cases, 4, BEST, TAIL, 1, bench, {group_of(cases[5]): 1.5, group_of(cases[6]): 0.5})
    first = {k: [j for stage in bench.stages for c, j in stage if c == k] for k in range(4)}
    assert first[0][:2] == [5, 6]
    bench = Bench(losses)
    race(cases, 4, BEST, TAIL, 4, bench)
    late = [j for stage in bench.stages for c, j in stage if c == 3]
    assert late[0] == 2  # candidates 0 to 2 have failed there


def test_equal_candidates_are_measured_until_one_differs() -> None:
    """Whether all losses are equal decides whether the distribution is updated."""
    cases = scenarios(4, 1)
    losses = np.zeros((6, 4))
    assert all(raced(losses, cases).complete)
    losses[5, 3] = 1.0
    found = raced(losses, cases)
    assert found.losses[:5] == [0.0] * 5 and found.losses[5] == pytest.approx(0.5)


def test_negative_losses_are_refused() -> None:
    with pytest.raises(ValueError, match=r"loss -1\.0 of candidate 0 in scenario 0: 0 or more expected"):
        raced(np.full((6, 4), -1.0), scenarios(4, 1))


def test_the_weakest_directions_count() -> None:
    cases = scenarios(4, 1)
    even, one_sided = [0.5] * 4, [0.0, 0.0, 2.0, 0.0]
    assert robust_loss(cases, even, 1.0) == robust_loss(cases, one_sided, 1.0) == 0.5
    assert robust_loss(cases, even, 0.25) == 0.5 and robust_loss(cases, one_sided, 0.25) == 2.0
    assert robust_loss([*cases, cases[2]], [*one_sided, 0.0], 0.25) == 1.0  # of a sector the mean
