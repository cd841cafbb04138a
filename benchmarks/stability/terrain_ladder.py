"""Ladders of increasingly hard ground, without and with range sensors: the level up to which enough walks survive."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pydantic import Field
from pydantic.dataclasses import dataclass as schema

from benchmarks.core.benchmark import ROUNDING, Benchmark, saved, settings
from benchmarks.core.harness import Case, LoadMeter, Options, Report, chosen, run_cases
from benchmarks.stability.falls import draw_failures
from benchmarks.stability.stairs import Flight, climb_flight
from benchmarks.stability.terrain import Condition, walk_under
from bridge.analysis.plots import new_figure
from models.config import STRICT, Count, Share
from models.errors import ConfigError
from models.profile import load_profile
from models.terrain import terrain_named

SEEN = "_seen"  #: Suffix of ladders that are walked with range sensors
COLUMNS = 4  #: Panels in a row of the picture


@schema(frozen=True, slots=True, config=STRICT)
class Ladder:
    """One kind of ground, from easy to hard: a walk without range sensors, or a flight, with or without them."""

    levels: Annotated[tuple[float, ...], Field(min_length=1)]
    unit: str  #: Unit of the levels
    field: str  #: Field of the walk, or else of its terrain, that is set to the level times ``scale``
    walk: Condition | Flight
    scale: float = 1.0

    def at(self, level: float) -> Condition | Flight:
        """The walk at a level."""
        value: dict[str, Any] = {self.field: level * self.scale}
        if isinstance(self.walk, Flight):
            return replace(self.walk, **value)
        if self.field in {entry.name for entry in fields(self.walk)}:
            return replace(self.walk, **value)
        return replace(self.walk, terrain=replace(terrain_named(self.walk.terrain), **value))


@schema(frozen=True, slots=True, config=STRICT)
class LadderConfig:
    """Settings of the test; ``benchmarks/config/terrain_ladder.yaml`` describes every value."""

    required_share: Share
    judging_seed: Count
    ladders: dict[str, Ladder]


_config = partial(settings, LadderConfig, "terrain_ladder")


def walk_level(robot: str, seed: int, scenario: str, level: float, contender: str = "") -> Case:
    """Walk once at a level of the ladder ``scenario``: ``walk_under`` or ``climb_flight``."""
    walk = _config().ladders[scenario].at(level)
    if isinstance(walk, Flight):
        return climb_flight(walk, robot, seed)
    return walk_under(walk, robot, seed, contender)


def ascend(
    levels: Sequence[float],
    seeds: Sequence[int],
    share: float,
    measure: Callable[[float, Sequence[int]], Sequence[Case]],
) -> list[Case]:
    """Walk every seed at one level after the other, including the first level at which less than a share survive.

    ``measure`` returns the cases of a level and some seeds. It is called with no more seeds than the failures that are
    still needed for the level not to be held, so the last level may end before all of its seeds are walked.
    """
    spare = math.floor((1.0 - share) * len(seeds) + ROUNDING)
    cases: list[Case] = []
    for level in levels:
        walked: list[Case] = []
        while (left := spare + 1 - sum(not case["survived"] for case in walked)) and len(walked) < len(seeds):
            walked += measure(level, seeds[len(walked) :][:left])
        cases += walked
        if not left:
            break
    return cases


def levels_of(cases: Sequence[Case]) -> dict[str, dict[float, tuple[int, int]]]:
    """Number of walks that survived, and of all walks, by ladder and level in the order of the cases."""
    found: dict[str, dict[float, tuple[int, int]]] = {}
    for case in cases:
        levels = found.setdefault(case["scenario"], {})
        survived, total = levels.get(case["level"], (0, 0))
        levels[case["level"]] = survived + case["survived"], total + 1
    return found


class TerrainLadder(Benchmark):
    """The ladders that the robot can walk, or the chosen ones, each up to the first level that is not held."""

    measure = staticmethod(walk_level)

    def run(self, options: Options) -> Report:
        load, config = LoadMeter(), _config()
        sensed = not options.contender and _sees_ground(options.robot)
        usual = [name for name, ladder in config.ladders.items() if sensed or not isinstance(ladder.walk, Flight)]
        cases: list[Case] = []
        for name in chosen(self.name, options.scenarios, list(config.ladders), usual):
            if name not in usual:
                raise ConfigError(
                    f"bench {self.name}: '{name}' needs a robot with range sensors and is not for contenders"
                )

            def measure(level: float, seeds: Sequence[int], name: str = name) -> list[Case]:
                subject = {"robot": options.robot, "scenario": name, "level": level, "contender": options.contender}
                asked = [{**subject, "seed": seed} for seed in seeds]
                return run_cases(self.measure, asked, bench=self.name, options=options)

            seeds = options.each_seed(config.judging_seed)
            cases += ascend(config.ladders[name].levels, seeds, config.required_share, measure)
        return self.report(options, cases, self.figures(cases), load)

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Hardest level ``held_`` of each ladder in its unit, NaN if none; ``survived_`` of ``total_`` per level."""
        held, counts = dict[str, float](), dict[str, float]()
        share = _config().required_share
        for name, levels in levels_of(cases).items():
            held[f"held_{name}"] = math.nan
            for level, (survived, total) in levels.items():
                counts |= {f"survived_{name}_{level:g}": float(survived), f"total_{name}_{level:g}": float(total)}
                if survived >= share * total - ROUNDING:
                    held[f"held_{name}"] = level
        return held | counts

    def notes(self, report: Report) -> list[str]:
        config, seeds = _config(), sorted({case["seed"] for case in report.cases})
        lines = super().notes(report)
        for name, levels in levels_of(report.cases).items():
            counts = (f"{level:g}: {survived} of {total}" for level, (survived, total) in levels.items())
            lines.append(f"{name} [{config.ladders[name].unit}]: {', '.join(counts)}")
        if seeds and seeds[0] < config.judging_seed:
            lines.append(f"seeds from {seeds[0]} on are for tuning only; judge with --first-seed {config.judging_seed}")
        return lines

    def plots(self, report: Report, folder: Path) -> list[Path]:
        picture = saved(draw_ladders([report]), folder / f"{self.name}-{report.stem}.png")
        return [picture, *draw_failures(report, folder)]


def _sees_ground(robot: str) -> bool:
    sensors = load_profile(robot).sensors
    return sensors.depth is not None or sensors.lidar is not None


def draw_ladders(reports: Sequence[Report]) -> Figure:
    """Share survived over level, one panel per kind of ground; dashed with range sensors, labelled below 1."""
    config = _config()
    found = {report.who: levels_of(report.cases) for report in reports}
    names = {name: None for levels in found.values() for name in levels}
    grounds = list(dict.fromkeys(name.removesuffix(SEEN) for name in names))
    rows = math.ceil(len(grounds) / COLUMNS)
    figure = new_figure(3.2 * min(COLUMNS, len(grounds)), 0.6 + 2.6 * rows)
    for place, ground in enumerate(grounds, start=1):
        axes = figure.add_subplot(rows, min(COLUMNS, len(grounds)), place)
        for number, (who, ladders) in enumerate(found.items()):
            for name, style in ((ground, "o-"), (ground + SEEN, "s--")):
                _draw_ladder(axes, ladders.get(name, {}), style, f"C{number}", f"{who}{', sensors' * (name != ground)}")
        ladder = config.ladders.get(ground) or config.ladders[ground + SEEN]
        if ladder.levels[0] > ladder.levels[-1]:
            axes.invert_xaxis()
        axes.margins(x=0.1)
        axes.axhline(config.required_share, color="k", linewidth=0.8, linestyle=":")
        axes.set(xlabel=f"{ground.replace('_', ' ')} [{ladder.unit}]", ylim=(-0.05, 1.08))
        axes.legend(fontsize=7, loc="lower left", frameon=False)
    figure.supylabel("share survived [-]", fontsize=9)
    return figure


def _draw_ladder(axes: Axes, levels: Mapping[float, tuple[int, int]], style: str, colour: str, label: str) -> None:
    """Plot the curve of one ladder; nothing without levels."""
    if not levels:
        return
    shares = [survived / total for survived, total in levels.values()]
    axes.plot(list(levels), shares, style, color=colour, markersize=4, linewidth=1.2, label=label)
    for (level, (survived, total)), share in zip(levels.items(), shares, strict=True):
        if survived < total:
            axes.annotate(f"{survived}/{total}", (level, share), xytext=(3, 3), textcoords="offset points", fontsize=7)
