r"""Search of parameters of the laws: CMA-ES on random pushes, judged on pushes that the search has not seen.

Every candidate of a generation gets the same scenarios (common random numbers), so that candidates differ by their
parameters alone. The loss of a scenario is 0 where the robot recovers, else 2 - t / T when it has lasted for t of the
time T until it counts as recovered. The loss of a candidate is robust:

.. math:: L = \text{mean of the largest } \lceil \alpha n \rceil \text{ of } \ell_1, \dots, \ell_n

with ``l_i`` the mean loss of a sector of directions and a kind of scenario, and ``alpha`` the ``tail``. The result is
the mean of the last distribution, not the luckiest candidate.

The search depends on its file and the seeds alone. Where finished scenarios are kept in a file (``Options.sweep``), it
goes through them again without measuring, and goes on where it ended.

References:
    Hansen: The CMA evolution strategy: a tutorial, arXiv 1604.00772; Rockafellar, Uryasev: Optimization of conditional
    value-at-risk, 2000.
"""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import yaml
from pydantic import Field
from pydantic.dataclasses import dataclass

from benchmarks.core.harness import Case, Options, run_cases
from benchmarks.core.provenance import revision
from benchmarks.stability.push import PushMode, direction_name
from benchmarks.stability.push_map import Trial, map_config, prepare, survives
from bridge.closed_loop import ClosedLoop
from controllers.whole_body.config import load_balance_config, load_whole_body_config
from models.config import STRICT, Count, NonNegative, Positive, Share, load_config, merged
from models.errors import ConfigError, PoiseError
from models.profile import load_profile, robot_names
from models.robot_model import RobotModel
from models.types import Vector
from planners.gait.scaling import load_gait_config

Parameters = dict[str, float]  #: Values by name, such as ``gait.swing.freeze``
Range = tuple[float, float]
LOADERS: dict[str, Callable[[RobotModel], Any]] = {
    "gait": load_gait_config,
    "balance": load_balance_config,
    "whole_body": load_whole_body_config,
}
DIGITS = 4  #: Significant digits of the result


@dataclass(frozen=True, slots=True, config=STRICT)
class Pushes:
    """Ranges of a kind of scenarios."""

    dv: tuple[NonNegative, NonNegative]  #: Impulse over mass [m/s]
    speed: tuple[Positive, Positive] = (0.4, 0.4)  #: Walking speed, without effect on a robot that stands [m/s]


@dataclass(frozen=True, slots=True, config=STRICT)
class TuneConfig:
    """What is searched, and how; see ``benchmarks/config/tune/recovery.yaml``."""

    parameters: dict[str, Range]
    scenarios: dict[PushMode, Pushes]
    directions: Count
    generations: Count
    population: Annotated[int, Field(ge=4)]
    spread: Share
    tail: Share
    seed: Annotated[int, Field(ge=0)]
    judged: Count

    def __post_init__(self) -> None:
        if len(self.parameters) < 2:
            raise ValueError("parameters: CMA-ES needs two or more")
        if PushMode.STAND in self.scenarios or not self.scenarios:
            raise ValueError("scenarios: one or more of catch, step, walk expected")
        for name, (low, high) in self.parameters.items():
            if not low < high:
                raise ValueError(f"parameters: {name}: [{low:g}, {high:g}] is no range")


def load_tune_config(name_or_path: str) -> TuneConfig:
    """A packaged search by name, or a file; ``ConfigError`` names file and key."""
    path = Path(__file__).resolve().parents[1] / "config" / "tune" / f"{name_or_path}.yaml"
    return load_config(TuneConfig, path if path.is_file() else Path(name_or_path))


def present(config: TuneConfig, robot: str) -> Parameters:
    """Values of a robot's parameters; ``ConfigError`` names one that is unknown, no number, or out of its range."""
    model, found = RobotModel.load(robot), {}
    roots = {root: loader(model) for root, loader in LOADERS.items()}
    for name, (low, high) in config.parameters.items():
        value: Any = roots
        for part in name.split("."):
            known = list(value) if isinstance(value, dict) else list(getattr(type(value), "__dataclass_fields__", ()))
            if part not in known:
                raise ConfigError(f"parameters: {name}: unknown '{part}'; known: {', '.join(known) or 'nothing'}")
            value = value[part] if isinstance(value, dict) else getattr(value, part)
        if not isinstance(value, float):
            raise ConfigError(f"parameters: {name}: {type(value).__name__} found, a number with decimals expected")
        if not low <= value <= high:
            raise ConfigError(f"parameters: {name}: {value:g} of {robot} is outside [{low:g}, {high:g}]: widen it")
        found[name] = value
    return found


def laws(parameters: Parameters) -> dict[str, Any]:
    """Nested keys of parameters, as ``laws`` of a profile has them."""
    nested: dict[str, Any] = {}
    for name, number in parameters.items():
        value: Any = number
        for part in reversed(name.split(".")):
            value = {part: value}
        nested = merged(nested, value)
    return nested


def draw(config: TuneConfig, round_: int) -> list[Case]:
    """Scenarios of a generation, or with its number ``generations`` those that judge."""
    rng, per = np.random.default_rng((config.seed, round_)), len(config.scenarios) * config.directions
    repeats = config.judged if round_ == config.generations else 1
    first, sector = config.seed + round_ * per, 2.0 * math.pi / config.directions
    scenarios: list[Case] = []
    for kind, pushes in list(config.scenarios.items()) * repeats:
        for k in range(config.directions):
            scenarios.append(
                {
                    "mode": kind.value,
                    "sector": k,
                    "seed": first + len(scenarios),
                    "phase": int(rng.integers(map_config().phases[kind])),
                    "angle": (sector * (k + rng.uniform(-0.5, 0.5))) % (2.0 * math.pi),
                    "dv": rng.uniform(*pushes.dv),
                    "speed": rng.uniform(*pushes.speed),
                }
            )
    return scenarios


@lru_cache(maxsize=2)
def _loop(robot: str, parameters: tuple[tuple[str, float], ...]) -> ClosedLoop:
    profile = load_profile(robot)
    tuned: Any = merged(profile.laws, laws(dict(parameters)))
    return ClosedLoop(RobotModel(replace(profile, laws=tuned)), record=False)


def trial(
    robot: str, parameters: Parameters, sector: int, mode: str, seed: int, phase: int, angle: float, dv: float,
    speed: float,
) -> Case:  # fmt: skip
    """One scenario: its ``loss`` [-] and the ``reason`` of a failure; parameters that the schema refuses fail."""
    config, pushed = map_config(), Trial(PushMode(mode), seed, phase, angle, speed)
    try:
        loop = _loop(robot, tuple(parameters.items()))
        prepare(loop, pushed)
    except PoiseError as error:
        return {"loss": 2.0, "reason": str(error)}
    outcome = survives(loop, pushed, dv)
    lasted = (loop.t - outcome.pushed) / (config.duration + config.recover_time)
    return {"loss": 2.0 - min(lasted, 1.0) if outcome.reason else 0.0, "reason": outcome.reason}


def robust_loss(results: Sequence[Case], tail: float) -> float:
    """Mean loss of the share ``tail`` of the groups by kind and sector, the worst ones."""
    groups: dict[tuple[str, int], list[float]] = {}
    for case in results:
        groups.setdefault((case["mode"], case["sector"]), []).append(case["loss"])
    worst = sorted((float(np.mean(losses)) for losses in groups.values()), reverse=True)
    return float(np.mean(worst[: math.ceil(tail * len(worst))]))


def measure(
    robot: str, candidates: Sequence[Parameters], scenarios: Sequence[Case], options: Options
) -> list[list[Case]]:
    """Results of every candidate in all scenarios."""
    cases = [{"robot": robot, "parameters": each, **scenario} for each in candidates for scenario in scenarios]
    results = run_cases(trial, cases, bench="tune", options=options)
    count = len(scenarios)
    return [results[k * count : (k + 1) * count] for k in range(len(candidates))]


Losses = Callable[[Sequence[Parameters], int], Sequence[float]]
Progress = Callable[[int, Sequence[float], Parameters], None]


def search(config: TuneConfig, start: Parameters, losses: Losses, progress: Progress = lambda *_: None) -> Parameters:
    """Minimise the losses of candidates in a generation from the present values on; returns the final mean.

    ``progress`` gets the generation, its losses and the mean after it. ``PoiseError`` without ``cmaes``.
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
    for generation in range(config.generations):
        points = [optimizer.ask() for _ in range(config.population)]
        found = losses([named(x) for x in points], generation)
        if min(found) < max(found):  # equal losses say nothing, and would let the mean drift
            optimizer.tell(list(zip(points, map(float, found), strict=True)))
        progress(generation, found, named(optimizer.mean))
    return named(optimizer.mean)


def tune(config: TuneConfig, options: Options, progress: Progress) -> tuple[Parameters, list[list[Case]]]:
    """The parameters found, and the results of present and found ones in the scenarios that judge."""
    robot, start = options.robot, present(config, options.robot)

    def losses(candidates: Sequence[Parameters], generation: int) -> list[float]:
        results = measure(robot, candidates, draw(config, generation), options)
        return [robust_loss(each, config.tail) for each in results]

    found = search(config, start, losses, progress)
    return found, measure(robot, [start, found], draw(config, config.generations), options)


def compare(config: TuneConfig, before: Sequence[Case], after: Sequence[Case]) -> list[tuple[str, str, str]]:
    """Rows of a table: what, before, after; how many pushes of each kind and sector were taken, and the losses."""

    def taken(results: Sequence[Case], kind: str, sector: int | None = None) -> str:
        of = [case for case in results if case["mode"] == kind and sector in (None, case["sector"])]
        return f"{sum(not case['reason'] for case in of)}/{len(of)}"

    rows = []
    for kind in config.scenarios:
        for k in range(config.directions):
            name = direction_name(2.0 * math.pi * k / config.directions)
            rows.append((f"{kind.value}, {name}", taken(before, kind, k), taken(after, kind, k)))
        rows.append((f"{kind.value}, all", taken(before, kind), taken(after, kind)))
    loss = [f"{robust_loss(results, config.tail):.3f}" for results in (before, after)]
    return [*rows, ("loss", loss[0], loss[1])]


def write_overlay(path: Path, robot: str, found: Mapping[str, float], remarks: Sequence[str]) -> None:
    """Write a profile that extends the robot's by the parameters found."""
    path.parent.mkdir(parents=True, exist_ok=True)
    source = Path(load_profile(robot).source)
    extended = robot if robot in robot_names() else os.path.relpath(source, path.parent)
    text = yaml.safe_dump({"extends": extended, "laws": laws(dict(found))}, sort_keys=False)
    lines = [f"{robot}, tuned by `poise tune` at revision {revision()}", *remarks]
    path.write_text("".join(f"# {line}".rstrip() + "\n" for line in lines) + text, encoding="utf-8")
