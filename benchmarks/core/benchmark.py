"""A benchmark: one class in one module, its settings and bounds in one YAML file, found by that file.

``benchmarks/config/NAME.yaml`` with a section ``bench`` (``Info`` of each report) and a module ``NAME.py`` in a folder
of ``benchmarks`` make a benchmark; docs/howto_benchmark.md shows a whole one.
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
ROUNDING = 1e-9  #: Relative rounding error by which a figure may miss its bound [-]


@dataclass(frozen=True, slots=True)
class Bound:
    """Range in which a figure must lie, in the figure's unit."""

    least: float = -math.inf
    most: float = math.inf

    def holds(self, figure: float) -> bool:
        """Whether the figure lies within; NaN does not."""
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
    """Upper bounds by figure."""
    return {name: Bound(most=value) for name, value in limits.items()}


def at_least(limits: Mapping[str, float]) -> dict[str, Bound]:
    """Lower bounds by figure."""
    return {name: Bound(least=value) for name, value in limits.items()}


@schema(frozen=True, slots=True, config=STRICT)
class Part:
    """Part of a benchmark that a suite measures: robots, number of seeds, and scenarios (the usual ones if empty)."""

    robots: tuple[str, ...]
    seeds: Count = 1
    scenarios: tuple[str, ...] = ()


@schema(frozen=True, slots=True, config=STRICT)
class Info:
    """Description of a benchmark."""

    about: str  #: Help text of its command
    order: int = 1000  #: Place in the suites and in the report
    command: str = ""  #: Name of the command when it differs from that of the report; several modes share one
    mode: str = ""  #: Value of the option ``--mode`` that selects it
    seeds: Count = 1  #: Default number of seeds
    choice: Literal["", "scenario", "direction"] = ""  #: Option that selects cases; none when empty
    contender: bool = False  #: Whether another controller can be tested
    quick: Part | None = None  #: Part of ``poise bench all --quick``; left out when None
    full: Part | None = None  #: Likewise, of ``--full``
    #: Figures in the summary of the report, with their names in words
    keys: dict[str, str] = field(default_factory=dict)
    figures: tuple[str, ...] = ()  #: Figures in the table of the report
    least: dict[str, float] = field(default_factory=dict)  #: Lower bounds of figures, in their units
    most: dict[str, float] = field(default_factory=dict)  #: Upper bounds of figures, in their units


class Benchmark(ABC):
    """Cases, their measurement, figures, bounds and plots; ``name`` is that of its reports."""

    #: Measures one case, given its inputs by name: a static method, since worker processes import it by name
    measure: ClassVar[Callable[..., Case]]
    #: Whether cases are measured one after another in this process, without workers and progress bar (timing)
    alone: ClassVar[bool] = False

    def __init__(self, name: str) -> None:
        self.name = name

    def cases(self, options: Options) -> list[Case]:
        """Inputs of every case, by default one a seed; ``ConfigError`` where the options name an unknown scenario."""
        return [{"robot": options.robot, "seed": seed} for seed in options.each_seed()]

    @abstractmethod
    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Figures of the measured cases."""

    def bounds(self, report: Report) -> dict[str, Bound]:
        """Bound of each figure that has one, by default ``least`` and ``most`` of its ``Info``.

        One that the report lacks fails, unless the benchmark has scenarios to choose from: it may be of another one.
        """
        listed = catalogue().get(self.name)
        return at_least(listed.info.least) | at_most(listed.info.most) if listed else {}

    def judged(self, report: Report) -> list[tuple[bool, str]]:
        """Whether each bound holds, and its figure in words."""
        bounds, listed = self.bounds(report), catalogue().get(self.name)
        optional = listed is None or listed.info.choice == "scenario"
        figures = {
            name: report.figures.get(name, math.nan) for name in bounds if name in report.figures or not optional
        }
        return [(bounds[name].holds(value), f"{name} {bounds[name]}: {value:.4g}") for name, value in figures.items()]

    def notes(self, report: Report) -> list[str]:
        """Remarks for the reader: by default one line for each bound."""
        return [f"{'ok    ' if ok else 'FAILED'} {text}" for ok, text in self.judged(report)]

    def passed(self, report: Report) -> bool:
        """Whether every bound holds."""
        return all(ok for ok, _ in self.judged(report))

    def plots(self, report: Report, folder: Path) -> list[Path]:
        """Draw the report into a folder, by default every figure over its bound; returns the files written."""
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
        axes.set_xlabel("figure over its bound (1 more than it where that is 0); red where the bound does not hold")
        axes.set_title(f"{report.bench}, {report.who}, seeds: {report.seeds}", fontsize=10)
        return [saved(figure, folder / f"{report.bench}-{report.stem}.png")]

    def survived(self, case: Case) -> tuple[str, bool] | None:
        """Group of the case in the report's table of survival, and whether it survived; optional."""
        return None

    def run(self, options: Options) -> Report:
        """Measure and judge every case; ``ConfigError`` for an unknown option, ``WorkersError`` without workers."""
        load = LoadMeter()
        results = run_cases(self.measure, self.cases(options), bench=self.name, options=options, alone=self.alone)
        return self.report(options, results, self.figures(results), load)

    def report(self, options: Options, cases: list[Case], figures: dict[str, float], load: LoadMeter) -> Report:
        """The judged report of measured cases."""
        found = Report(
            self.name, options.robot, options.seeds, figures, cases, False, load.read(), contender=options.contender
        )
        return replace(found, passed=self.passed(found), notes=self.notes(found))


def by_scenario(cases: Sequence[Case]) -> dict[str, list[Case]]:
    """Cases of each scenario, in the order of the first ones."""
    found: dict[str, list[Case]] = {}
    for case in cases:
        found.setdefault(case["scenario"], []).append(case)
    return found


class SurvivalBenchmark(Benchmark):
    """Walks of named scenarios, once a seed; enough must survive. A case has ``scenario`` and ``survived``."""

    required_share: float  #: Of the walks of each usual scenario that must survive; none survives where none ran [-]
    usual: Mapping[str, Any]  #: Scenarios by name
    required: Mapping[str, Any] = {}  #: Those that are measured only when chosen, with the bound of the usual ones
    goals: Mapping[str, Any] = {}  #: The same without a bound
    first_seed = 0  #: Without the option

    def cases(self, options: Options) -> list[Case]:
        names = chosen(self.name, options.scenarios, [*self.usual, *self.required, *self.goals], list(self.usual))
        seeds = options.each_seed(self.first_seed)
        return [{"robot": options.robot, "seed": seed, "scenario": name} for name in names for seed in seeds]

    def figures(self, cases: list[Case]) -> dict[str, float]:
        """Of each scenario ``survived_`` of ``total_`` walks, and what ``further`` has."""
        figures = {}
        for name, of in by_scenario(cases).items():
            figures[f"survived_{name}"] = float(sum(case["survived"] for case in of))
            figures[f"total_{name}"] = float(len(of))
            figures |= self.further(name, of)
        return figures

    @abstractmethod
    def further(self, name: str, cases: list[Case]) -> dict[str, float]:
        """More figures of a scenario."""

    def bounds(self, report: Report) -> dict[str, Bound]:
        totals = {name: report.figures.get(f"total_{name}", 0.0) for name in (*self.usual, *self.required)}
        return at_least({f"survived_{name}": self.required_share * total for name, total in totals.items()})

    def survived(self, case: Case) -> tuple[str, bool]:
        return case["scenario"], bool(case["survived"])


@dataclass(frozen=True, slots=True)
class Listed:
    """A benchmark of the catalogue, by the name of its reports; its module is not imported yet."""

    name: str
    info: Info
    module: str

    @property
    def command(self) -> str:
        """Name of its command."""
        return self.info.command or self.name

    def load(self) -> Benchmark:
        """Import the module and make its benchmark; ``PoiseError`` unless it defines one and finds all it imports."""
        try:
            module = import_module(self.module)
        except ModuleNotFoundError as error:
            advice = "for ROS 2: pip install 'poise[ros]' (x86-64 Linux), or source a ROS 2 Jazzy"
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
    """Settings of a benchmark: ``config/NAME.yaml`` without descriptions; ``ConfigError`` for a wrong key."""
    return cast(T, _settings(cast(Any, schema), name))


@cache
def _settings(schema: Any, name: str) -> Any:
    file = ROOT / "config" / f"{name}.yaml"
    return parse_config(schema, {key: value for key, value in read_yaml(file).items() if key != SECTION}, str(file))


@cache
def catalogue(root: Path = ROOT) -> dict[str, Listed]:
    """Every benchmark by the name of its reports, in order; ``ConfigError`` for a wrong description or no module."""
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
    """Bounds of a report's figures; none for a benchmark that the catalogue lacks."""
    listed = catalogue().get(report.bench)
    return listed.load().bounds(report) if listed else {}


def saved(figure: Figure, file: Path) -> Path:
    """Write a figure; returns its file."""
    figure.savefig(file, dpi=110)
    return file
