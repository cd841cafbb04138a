"""What the scaling benchmark makes of its rounds."""

import math

import pytest

from benchmarks.core.harness import Case
from benchmarks.speed.scaling import same, summarise


def rounds(wall_2: float, *, differs: bool = False) -> list[Case]:
    """Four cases of 10 s over one worker in 44 s, and over two."""
    return [
        {
            "workers": workers,
            "wall": wall,
            "seconds": 10.0,
            "seed": seed,
            "outcome": {"distance": 4.0 + seed + 1e-12 * (differs and workers == 2 and seed == 3), "dcm": [math.nan]},
        }
        for workers, wall in ((1, 44.0), (2, wall_2))
        for seed in range(4)
    ]


def test_cost_speed_up_and_plan() -> None:
    figures = summarise(rounds(27.5), planned=100_000)
    assert figures == pytest.approx(
        {
            "case_s": 10.0,
            "overhead_s": 1.0,
            "planned_cases": 100_000.0,
            "wall_1_s": 44.0,
            "speedup_1": 1.0,
            "efficiency_1": 1.0,
            "planned_1_hours": 100_000 * 11.0 / 3600.0,
            "wall_2_s": 27.5,
            "speedup_2": 1.6,
            "efficiency_2": 0.8,
            "planned_2_hours": 100_000 * 6.875 / 3600.0,
        }
    )


def test_one_bit_of_difference_is_seen() -> None:
    assert same(rounds(22.0))
    assert not same(rounds(22.0, differs=True))
