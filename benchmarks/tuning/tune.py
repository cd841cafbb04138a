"""Search for parameters of the laws with CMA-ES in closed loop, judged on scenarios that are not used in the search.

All candidates of a generation run the same scenarios (common random numbers), so that they differ only by their
parameters; the next generation has others. ``scenarios.py`` draws and simulates them. ``race.py`` computes the robust
loss and skips scenarios that cannot affect the result. The result is the mean of the last distribution, not the best
candidate, which may be lucky.

The search depends only on its file and the seeds. With a file of finished scenarios (``Options.sweep``), a rerun reads
them instead of measuring them again, and continues where the search ended.

References:
    Hansen: The CMA evolution strategy: a tutorial, arXiv 1604.00772.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.core.harness import Case, Options, run_cases
from benchmarks.tuning.config import Parameters, TuneConfig, present
from benchmarks.tuning.race import Group, Raced, group_of, race
from benchmarks.tuning.scenarios import draw, trial
from models.errors import PoiseError
from models.types import Vector

DIGITS = 4  #: Significant digits of the parameters


@dataclass(frozen=True, slots=True)
class Generation:
    """Summary of one generation."""

    losses: list[float]  #: Losses of the ``mu`` best candidates, ascending [-]
    parameters: Parameters  #: Mean of the distribution after the generation
    measured: int  #: Number of measured scenarios
    total: int  #: Number of scenarios, including skipped ones


@dataclass(frozen=True, slots=True)
class Tuned:
    """Result of a search."""

    start: Parameters
    found: Parameters
    history: list[Generation]
    before: list[Case]  #: Judging scenarios with the initial parameters
    after: list[Case]  #: Judging scenarios with the found parameters
    cpu: float  #: Processor time of all scenarios, including those from the file [s]

    @property
    def cost(self) -> str:
        """Cost of the search as text."""
        measured, total = (sum(getattr(each, name) for each in self.history) for name in ("measured", "total"))
        judging = len(self.before) * (1 if self.found == self.start else 2)
        return (
            f"{self.cpu / 3600.0:.2f} core-hours, {measured} of {total} scenarios of the search, {judging} for judging"
        )


Losses = Callable[[Sequence[Parameters], int], Raced]


def search(
    config: TuneConfig, start: Parameters, losses: Losses, progress: Callable[[Generation], None] = lambda _: None
) -> list[Generation]:
    """Minimise the losses of the candidates of each generation, starting at ``start``.

    ``progress`` receives each finished generation. ``PoiseError`` without ``cmaes``.
    """
    try:
        from cmaes import CMA
    except ImportError as error:
        raise PoiseError("poise tune needs cmaes: pip install 'poise[bench]'") from error
    low, high = np.array(list(config.parameters.values())).T

    def named(x: Vector) -> Parameters:
        values = low + np.clip(x, 0.0, 1.0) * (high - low)
        return {name: float(f"{value:.{DIGITS}g}") for name, value in zip(config.parameters, values, strict=True)}

    bounds = np.tile((0.0, 1.0), (len(low), 1))
    mean = (np.array([start[name] for name in config.parameters]) - low) / (high - low)
    optimizer = CMA(mean, config.spread, bounds, seed=config.seed, population_size=config.population)
    history = []
    for number in range(config.generations):
        points = [optimizer.ask() for _ in range(config.population)]
        raced = losses([named(x) for x in points], number)
        if min(raced.losses) < max(raced.losses):  # equal losses have no information, and would let the mean drift
            optimizer.tell(list(zip(points, map(float, raced.losses), strict=True)))
        best, measured = sorted(raced.losses)[: config.best], int((~np.isnan(raced.table)).sum())
        history.append(Generation(best, named(optimizer.mean), measured, raced.table.size))
        progress(history[-1])
    return history


def tune(
    config: TuneConfig,
    options: Options,
    progress: Callable[[Generation], None] = lambda _: None,
    advance: Callable[[int], None] = lambda _: None,
) -> Tuned:
    """Search, then judge the present and the found parameters.

    ``advance`` receives the number of scenarios measured or skipped since its last call.
    """
    start, cpu = present(config, options.robot), 0.0
    earlier: dict[Group, list[float]] = {}

    def measure(cases: Sequence[tuple[Parameters, Case]]) -> list[Case]:
        nonlocal cpu
        inputs = [{"robot": options.robot, "parameters": each, **scenario} for each, scenario in cases]
        results = run_cases(trial, inputs, bench="tune", options=options, silent=True)
        cpu += sum(case["cpu"] for case in results)
        advance(len(results))
        return results

    def losses(candidates: Sequence[Parameters], generation: int) -> Raced:
        scenarios = draw(config, generation)

        def lost(pairs: Sequence[tuple[int, int]]) -> list[float]:
            return [case["loss"] for case in measure([(candidates[k], scenarios[j]) for k, j in pairs])]

        expected = {group: float(np.mean(values)) for group, values in earlier.items()}
        raced = race(scenarios, len(candidates), config.best, config.tail, config.block, lost, expected)
        for scenario, column in zip(scenarios, raced.table.T, strict=True):
            earlier.setdefault(group_of(scenario), []).extend(column[~np.isnan(column)])
        advance(int(np.isnan(raced.table).sum()))
        return raced

    history = search(config, start, losses, progress)
    found, judging = history[-1].parameters, draw(config, config.generations)
    tried = [start] if found == start else [start, found]
    results = measure([(each, scenario) for each in tried for scenario in judging])
    return Tuned(start, found, history, results[: len(judging)], results[-len(judging) :], cpu)
