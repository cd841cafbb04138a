"""What is kept in the place of samples gives their percentiles, of one case and of several."""

import numpy as np
import pytest

from benchmarks.core.timed_run import QUANTILES, percentiles_of, spread

RNG = np.random.default_rng(5)


def test_percentiles_of_one_are_those_of_its_samples() -> None:
    samples = RNG.lognormal(6.0, 0.4, 20_000)
    np.testing.assert_allclose(percentiles_of([spread(samples)]), np.percentile(samples, QUANTILES))
    assert percentiles_of([spread(np.full(7, 3.0))], [50.0, 99.9]).tolist() == [3.0, 3.0]


def test_percentiles_of_several_weigh_each_by_its_samples() -> None:
    parts = [RNG.lognormal(mean, 0.3, size) for mean, size in ((6.0, 20_000), (6.5, 5_000), (7.0, 1_000))]
    found = percentiles_of([spread(part) for part in parts], [10.0, 50.0, 90.0, 99.0, 99.9, 100.0])
    exact = np.percentile(np.concatenate(parts), [10.0, 50.0, 90.0, 99.0, 99.9, 100.0])
    np.testing.assert_allclose(found[:4], exact[:4], rtol=0.01)
    assert found[4] == pytest.approx(exact[4], rel=0.1) and found[5] == exact[5]
    one = percentiles_of([spread(np.full(300, 1.0)), spread(np.full(100, 2.0))], [50.0, 90.0])
    assert one.tolist() == [1.0, pytest.approx(2.0, abs=0.5)]


def test_nothing_has_no_percentiles_and_does_not_count() -> None:
    assert np.isnan(percentiles_of([spread([])], [50.0, 100.0])).all() and np.isnan(percentiles_of([], [50.0])).all()
    assert percentiles_of([spread([]), spread([1.0, 3.0])], [50.0]).tolist() == [2.0]
