"""A small search of ``poise tune`` for tests."""

from benchmarks.stability.push import PushMode
from benchmarks.tuning.config import Kind, TuneConfig

SMALL = TuneConfig(
    parameters={"gait.step_share": (0.7, 1.0), "balance.dcm_gain": (3.0, 8.0)},
    scenarios={"step": Kind(PushMode.STEP, (0.4, 1.2)), "slope": Kind(slope=(0.05, 0.2))},
    directions=4,
    generations=12,
    population=6,
    block=2,
    spread=0.3,
    tail=0.5,
    seed=500,
    judged=2,
    tolerance=0.02,
    held_out={"tiles": Kind(tiles=(0.01, 0.05))},
)
