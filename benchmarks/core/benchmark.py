"""Base class and catalogue of the benchmarks.

A benchmark consists of ``benchmarks/config/NAME.yaml``, with settings, bounds and a section ``bench`` (``Info`` of each
report), and of one class in a module ``NAME.py`` in a folder of ``benchmarks``. Example: docs/howto_benchmark.md.
"""

from __future__ import annotations

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar, cast

from pydantic.dataclasses import dataclass as schema

from benchmarks.core.harness import Case, LoadMeter, Options, Report, chosen, run_cases
from models.config import STRICT, Count, parse_config, read_yaml
from models.errors import ConfigError, PoiseError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

T = TypeVar("T")


ROOT = Path(__file__).resolve().parents[1]  #: Folder of the benchmarks
SECTION = "bench"  #: Key of the descriptions in a benchmark's YAML file
ROUNDING = 1e-9  #: Relative rounding error by which a figure may exceed its bound [-]


@dataclass(frozen=True, slots=True)
class Bound:
    """Permitted range of a figure, in the unit of the figure."""

    least: float = -math.inf
    most: float = math.inf

    def holds(self, figure: float) -> bool:
        """Whether the figure is in the range; false for NaN."""
        return bool(
            self.least - ROUNDING * abs(self.least) <= figure
            if math.isinf(self.most)
            else self.least <= figure <= self.most + ROUNDING * abs(self.most)
        )

    def __str__(self) -> str:
        if math.isinf(self.most):
            return f"≥ {self.least:.4g}"
        return f"≤ {self.most:.4g}" if math.isinf(self.least) else f"{self.least:.4g} to {self.most:.4g}"


def at_most(limits: Mapping[str, float]) -> dict[str, Bound]:
    """Return upper bounds by figure."""
    return {name: Bound(most=value) for name, value in limits.items()}


def at_least(limits: Mapping[str, float]) -> dict[str, Bound]:
    """Return lower bounds by figure."""
    return {name: Bound(least=value) for name, value in limits.items()}


@schema(frozen=True, slots=True, config=STRICT)
class Part:
    """Part of a benchmark that a suite runs: robots, number of seeds, and scenarios (the default ones if empty)."""

    robots: tuple[str, ...]
    seeds: Count = 1
    scenarios: tuple[str, ...] = ()


@schema(frozen=True, slots=True, config=STRICT)
class Info:
    """Description of a benchmark."""

    about: str  #: Help text of the command
    order: int = 1000  #: Position in the suites and in the report
    command: str = ""  #: Name of the command, if it is not the name of the report; several modes share one command
    mode: str = ""  #: Value of ``--mode`` that selects this entry
    seeds: Count = 1  #: Default number of seeds
    choice: Literal["", "scenario", "direction"] = ""  #: Option that selects cases; none when empty
    contender: bool = False  #: Whether another controller can be tested
    quick: Part | None = None  #: Part in ``poise bench all --quick``; left out when None
    full: Part | None = None  #: Part in ``poise bench all --full``; left out when None
    #: Figures in the summary of the report, with their description
    keys: dict[str, str] = field(default_factory=dict)
    figures: tuple[str, ...] = ()  #: Figures in the table of the report
    least: dict[str, float] = field(default_factory=dict)  #: Lower bounds of figures, in their units
    most: dict[str, float] = field(default_factory=dict)  #: Upper bounds of figures, in their units


class Benchmark(ABC):
    """Cases, measurement, figures, bounds and plots of one benchmark; ``name`` is the name of its reports."""

    #: Measures one case, given its inputs by name; a static method, because worker processes import it by name
    measure: ClassVar[Callable[..., Case]]
    #: Whether cases run one after another in this process, without workers and progress bar, for timing
    alone: ClassVar[bool] = False

    def __init__(self, name: str) -> None:
        self.name = name

    def cases(self, options: Options) -> list[Case]:
        """Return the inputs of every case, by default one per seed; ``ConfigError`` for an unknown scenario."""
        return [{"robot": options.robot, "seed": seed} for seed in options.each_seed()]

    @abstractmethod
    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Compute the figures of the measured cases."""

    def bounds(self, report: Report) -> dict[str, Bound]:
        """Return the bounds by figure, by default ``least`` and ``most`` of ``Info``.

        A bound without a figure fails, unless scenarios can be selected: other scenarios have other figures.
        """
        listed = catalogue().get(self.name)
        return at_least(listed.info.least) | at_most(listed.info.most) if listed else {}

    def judged(self, report: Report) -> list[tuple[bool, str]]:
        """Return, for each bound, whether it holds, and a text with bound and figure."""
        bounds, listed = self.bounds(report), catalogue().get(self.name)
        optional = listed is None or listed.info.choice == "scenario"
        figures = {
            name: report.figures.get(name, math.nan) for name in bounds if name in report.figures or not optional
        }
        return [(bounds[name].holds(value), f"{name} {bounds[name]}: {value:.4g}") for name, value in figures.items()]

    def notes(self, report: Report) -> list[str]:
        """Return remarks for the reader, by default one line per bound."""
        return [f"{'ok    ' if ok else 'FAILED'} {text}" for ok, text in self.judged(report)]

    def passed(self, report: Report) -> bool:
        """Whether every bound holds."""
        return all(ok for ok, _ in self.judged(report))

    def plots(self, report: Report, folder: Path) -> list[Path]:
        """Plot the report into a folder, by default every figure over its bound; returns the files written."""
        from bridge.analysis.plots import new_figure

        bounds = {name: bound for name, bound in self.bounds(report).items() if name in report.figures}
        limits = {name: bound.least if math.isinf(bound.most) else bound.most for name, bound in bounds.items()}
        shares = {
            name: report.figures[name] / limit if limit else 1.0 + report.figures[name]
            for name, limit in limits.items()
        }
        if not shares:
            return []
        figure = new_figure(8.0, 1.2 + 0.25 * len(shares))
        axes = figure.add_subplot()
        colours = ["C0" if bounds[name].holds(report.figures[name]) else "C3" for name in shares]
        axes.barh([f"{name} ({bounds[name]})" for name in shares], list(shares.values()), color=colours)
        axes.axvline(1.0, color="k", linewidth=0.8, linestyle="--")
        axes.set_xlabel("figure / bound (1 + figure where the bound is 0); red: the bound does not hold")
        axes.set_title(f"{report.bench}, {report.who}, seeds: {report.seeds}", fontsize=10)
        return [saved(figure, folder / f"{report.bench}-{report.stem}.png")]

    def survived(self, case: Case) -> tuple[str, bool] | None:
        """Return the group of the case in the survival table and whether it survived; None: not in the table."""
        return None

    def run(self, options: Options) -> Report:
        """Run and judge all cases; ``ConfigError`` for an unknown option, ``WorkersError`` without workers."""
        load = LoadMeter()
        results = run_cases(self.measure, self.cases(options), bench=self.name, options=options, alone=self.alone)
        return self.report(options, results, self.figures(results), load)

    def report(self, options: Options, cases: list[Case], figures: dict[str, float], load: LoadMeter) -> Report:
        """Build the judged report from measured cases."""
        found = Report(
            self.name, options.robot, options.seeds, figures, cases, False, load.read(), contender=options.contender
        )
        return replace(found, passed=self.passed(found), notes=self.notes(found))


def by_scenario(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Group cases by scenario, in order of first appearance."""
    found: dict[str, list[Case]] = {}
    for case in cases:
        found.setdefault(case["scenario"], []).append(case)
    return found


class SurvivalBenchmark(Benchmark):
    """Walks of named scenarios, one per seed; a share must survive. A case has ``scenario`` and ``survived``."""

    required_share: float  #: Minimum share of surviving walks per usual scenario; a scenario without walks fails [-]
    usual: Mapping[str, Any]  #: Scenarios that run by default, by name
    required: Mapping[str, Any] = {}  #: Scenarios that run only when selected, with the same bound
    goals: Mapping[str, Any] = {}  #: Scenarios that run only when selected, without a bound
    first_seed = 0  #: Default of ``--first-seed``

    def cases(self, options: Options) -> list[Case]:
        names = chosen(self.name, options.scenarios, [*self.usual, *self.required, *self.goals], list(self.usual))
        seeds = options.each_seed(self.first_seed)
        return [{"robot": options.robot, "seed": seed, "scenario": name} for name in names for seed in seeds]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Return ``survived_`` and ``total_`` walks of each scenario, and its figures from ``further``."""
        figures = {}
        for name, of in by_scenario(cases).items():
            figures[f"survived_{name}"] = float(sum(case["survived"] for case in of))
            figures[f"total_{name}"] = float(len(of))
            figures |= self.further(name, of)
        return figures

    @abstractmethod
    def further(self, name: str, cases: list[Case]) -> dict[str, float]:
        """Return additional figures of a scenario."""

    def bounds(self, report: Report) -> dict[str, Bound]:
        totals = {name: report.figures.get(f"total_{name}", 0.0) for name in (*self.usual, *self.required)}
        return at_least({f"survived_{name}": self.required_share * total for name, total in totals.items()})

    def survived(self, case: Case) -> tuple[str, bool]:
        return case["scenario"], bool(case["survived"])


@dataclass(frozen=True, slots=True)
class Listed:
    """Entry of the catalogue, by report name; the module is imported by ``load``."""

    name: str
    info: Info
    module: str

    @property
    def command(self) -> str:
        """Name of the command."""
        return self.info.command or self.name

    def load(self) -> Benchmark:
        """Import the module and create its benchmark; ``PoiseError`` if the class or an import is missing."""
        try:
            module = import_module(self.module)
        except ModuleNotFoundError as error:
            advice = "for ROS 2: pip install 'poise[ros]' (x86-64 Linux), or source ROS 2 Jazzy"
            raise PoiseError(f"bench {self.command}: {error}; {advice}") from error
        found = [
            each
            for each in vars(module).values()
            if inspect.isclass(each) and issubclass(each, Benchmark) and each.__module__ == module.__name__
        ]
        if len(found) != 1:
            raise ConfigError(f"{self.module}: one class derived from Benchmark expected, found {len(found)}")
        made: Benchmark = found[0](self.name)
        return made


def settings(schema: type[T], name: str) -> T:
    """Load the settings of a benchmark: ``config/NAME.yaml`` without ``bench``; ``ConfigError`` for a wrong key."""
    return cast(T, _settings(cast(Any, schema), name))


@cache
def _settings(schema: Any, name: str) -> Any:
    file = ROOT / "config" / f"{name}.yaml"
    return parse_config(schema, {key: value for key, value in read_yaml(file).items() if key != SECTION}, str(file))


@cache
def catalogue(root: Path = ROOT) -> dict[str, Listed]:
    """Return all benchmarks by report name, in order; ``ConfigError`` for an invalid ``bench`` or no single module."""
    found: list[Listed] = []
    for file in sorted((root / "config").glob("*.yaml")):
        described: dict[str, Any] = read_yaml(file).get(SECTION) or {}
        modules = [path.relative_to(root.parent).with_suffix("") for path in sorted(root.glob(f"*/{file.stem}.py"))]
        if described and len(modules) != 1:
            raise ConfigError(f"{file}: one module */{file.stem}.py expected, found {len(modules)}")
        for name, data in described.items():
            info = parse_config(Info, data, f"{file}: {SECTION}.{name}")
            found.append(Listed(name, info, ".".join(modules[0].parts)))
    return {each.name: each for each in sorted(found, key=lambda each: (each.info.order, each.name))}


def bounds_of(report: Report) -> dict[str, Bound]:
    """Return the bounds of a report's figures; empty for a benchmark that is not in the catalogue."""
    listed = catalogue().get(report.bench)
    return listed.load().bounds(report) if listed else {}


def saved(figure: Figure, file: Path) -> Path:
    """Write a figure and return its file."""
    figure.savefig(file, dpi=110)
    return file
