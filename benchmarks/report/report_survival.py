"""Survival shares with intervals, and their plots: curves over time and push size, push maps, uneven ground."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes
from scipy.stats import binomtest

from benchmarks.core.benchmark import catalogue, settings
from benchmarks.core.harness import Report
from benchmarks.report.report_plots import MAP, Reports, colour, look, robots_of
from benchmarks.stability import push, push_map
from benchmarks.stability.push import draw_rings
from benchmarks.stability.terrain import TerrainConfig
from benchmarks.stability.terrain_ladder import draw_ladders
from bridge.analysis.plots import new_figure

CONFIDENCE = 0.95  # confidence of the two-sided intervals [-]


@dataclass(frozen=True, slots=True)
class Share:
    """Number of survived trials of a robot, by name."""

    name: str
    robot: str
    survived: int
    total: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the share at ``CONFIDENCE`` [-]."""
        return wilson(self.survived, self.total)


def wilson(survived: int, total: int) -> tuple[float, float]:
    """Return Wilson's two-sided interval of a share, for at least one trial, at ``CONFIDENCE`` [-]."""
    found = binomtest(survived, total).proportion_ci(CONFIDENCE, method="wilson")
    return float(found.low), float(found.high)


def shares(reports: Iterable[Report]) -> list[Share]:
    """Return the survival of every benchmark that defines it, by scenario."""
    found: list[Share] = []
    for report in reports:
        listed = catalogue().get(report.bench)
        benchmark = listed.load() if listed else None
        groups: dict[str, list[bool]] = {}
        for case in report.cases if benchmark else ():
            outcome = benchmark.survived(case) if benchmark else None
            if outcome is not None:
                groups.setdefault(f"{report.bench}: {outcome[0]}", []).append(outcome[1])
        found += [Share(name, report.robot, sum(held), len(held)) for name, held in groups.items()]
    return found


def lasting(ends: Sequence[float], at: Sequence[float]) -> list[tuple[float, float, float]]:
    """Return the share of ``ends`` at or after each of ``at``, with the bounds of its interval [-]."""
    counts = [sum(end >= x for end in ends) for x in at]
    return [(count / len(ends), *wilson(count, len(ends))) for count in counts]


PUSHES = ("push", "push_catch", "push_step", "push_walk")  # benchmarks that search the largest push

#: Task of the robot during the push
DOING = dict(zip(PUSHES, ("standing, no step", "mode 'stand', steps", "mode 'walk', steps", "walking"), strict=True))
COLUMNS = 2  # maps per row


def draw_push_maps(reports: Reports) -> Figure | None:
    """Largest push of 0.1 s at the pelvis that is taken, as impulse over mass, by direction, beside its bounds."""
    found = [(bench, robot) for bench in PUSHES for known, robot in reports if known == bench]
    if not found:
        return None
    rows = math.ceil(len(found) / COLUMNS)
    figure = new_figure(9.0, 5.6 * rows)
    figure.set_layout_engine("constrained", h_pad=0.15)
    for place, (bench, robot) in enumerate(found, start=1):
        report = reports[bench, robot]
        shown = (push if bench == "push" else push_map).push_map(report)
        axes = cast(PolarAxes, figure.add_subplot(rows, COLUMNS, place, projection="polar"))
        draw_rings(axes, shown)
        axes.set_title(f"{robot}, {shown.cases[0]['mass']:.1f} kg, seeds: {report.seeds}\n{shown.title}", fontsize=10)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.1), fontsize=8, ncols=2)
    figure.suptitle("Largest push at the pelvis that is taken, impulse over mass [m/s], by direction", fontsize=11)
    return figure


POINTS = 200  # number of points of a curve
BARS = 8  # number of intervals drawn on a curve


def draw_shares(reports: Reports) -> Figure | None:
    """Share of the trials that went as the benchmark asks, with Wilson's interval of 95 %."""
    found = shares(reports.values())
    if not found:
        return None
    names = list(dict.fromkeys(share.name for share in found))
    robots = robots_of(reports)
    figure = new_figure(9.0, 1.2 + 0.27 * len(names))
    axes = figure.add_subplot()
    for share in found:
        place = names.index(share.name) + 0.25 * (robots.index(share.robot) - 0.5 * (len(robots) - 1))
        given, low, high = share.survived / share.total, *share.interval
        shade, mark = look(reports, share.robot)
        axes.plot([low, high], [place, place], color=shade, linewidth=1.2, marker="|", markersize=5)
        axes.plot([given], [place], mark, color=shade, markersize=5)
    for robot in robots:
        shade, mark = look(reports, robot)
        axes.plot([], [], mark, color=shade, label=robot)
    totals = {name: sorted({share.total for share in found if share.name == name}) for name in names}
    labels = [f"{name.replace('_', ' ')} ({', '.join(map(str, totals[name]))})" for name in names]
    axes.set_yticks(range(len(names)), labels, fontsize=8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(-0.02, 1.03)
    axes.set_xlabel("share survived [-]")
    axes.grid(axis="x", alpha=0.3)
    axes.legend(fontsize=8, loc="lower left")
    axes.set_title("Survived, with Wilson's interval of 95 %; in parentheses the trials of a robot", fontsize=10)
    return figure


def draw_curves(reports: Reports) -> Figure | None:
    """Share of blind walks that go on, over time; share of directions and seeds in which a push is taken, by its size.

    Bars are Wilson's intervals of 95 %, as if directions and conditions were drawn at random.
    """
    walked = robots_of(reports, "terrain")
    pushed = [key for bench in PUSHES for key in reports if key[0] == bench]
    panels = bool(walked) + bool(pushed)
    if not panels:
        return None
    figure = new_figure(4.5 * panels, 4.2)
    left, *rest = figure.subplots(1, panels, squeeze=False)[0]
    if walked:
        longest = max(case["time"] for robot in walked for case in reports["terrain", robot].cases)
        for place, robot in enumerate(walked):
            cases = reports["terrain", robot].cases
            ends = [case["time"] if case["fell"] else math.inf for case in cases]
            label = f"{robot}, {len(ends)} walks"
            _draw_curve(left, ends, (longest, place / len(walked)), label, colour(reports, robot), "-")
        left.set(xlabel="time on uneven ground [s]", ylabel="share still up [-]")
        left.set_title("blind walks, all conditions", fontsize=10)
    if pushed:
        axes = rest[0] if walked else left
        largest = 1.1 * max(case["dv"] for key in pushed for case in reports[key].cases)
        styles = dict(zip(PUSHES, ("-", "-.", "--", ":"), strict=True))
        for place, (bench, robot) in enumerate(pushed):
            sizes = [case["dv"] for case in reports[bench, robot].cases]
            label = f"{robot}, {DOING[bench]}, {len(sizes)}"
            reach = (largest, place / len(pushed))
            _draw_curve(axes, sizes, reach, label, colour(reports, robot), styles[bench])
        axes.set(xlabel="impulse over mass at the pelvis [m/s]", ylabel="share that take it [-]")
        axes.set_title("pushes, by directions and seeds (how many)", fontsize=10)
    for axes in (left, *rest):
        axes.set_ylim(0.0, 1.03)
        axes.set_xlim(left=0.0)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower left" if walked and axes is left else "upper right")
    return figure


def _draw_curve(
    axes: Axes, ends: Sequence[float], reach: tuple[float, float], label: str, shade: str, style: str
) -> None:
    """Draw a curve up to ``reach[0]``, with intervals shifted by ``reach[1]`` of half their spacing [-]."""
    last, late = reach
    at = np.linspace(0.0, last, POINTS)
    axes.step(at, np.array(lasting(ends, at.tolist()))[:, 0], where="post", color=shade, linestyle=style, label=label)
    barred = (np.arange(BARS) + 0.25 + 0.5 * late) * last / BARS
    for x, (share, low, high) in zip(barred, lasting(ends, barred.tolist()), strict=True):
        axes.errorbar(x, share, [[share - low], [high - share]], color=shade, capsize=2, linewidth=0.8)


def draw_terrain(reports: Reports) -> Figure | None:
    """Blind walks that were survived, by ground and robot, of how many, and Wilson's interval of their share."""
    robots = robots_of(reports, "terrain")
    if not robots:
        return None
    found = {(share.name, share.robot): share for share in shares(reports["terrain", robot] for robot in robots)}
    names = list(dict.fromkeys(name for name, _ in found))
    values = np.full((len(robots), len(names)), np.nan)
    figure = new_figure(9.0, 1.6 + 0.6 * len(robots))
    axes = figure.add_subplot()
    for (name, robot), share in found.items():
        row, column = robots.index(robot), names.index(name)
        values[row, column] = share.survived / share.total
        text = f"{share.survived}/{share.total}\n{share.interval[0]:.2f} to {share.interval[1]:.2f}"
        shade = "black" if values[row, column] > 0.5 else "white"
        axes.text(column, row, text, ha="center", va="center", fontsize=8, color=shade)
    image = axes.imshow(values, vmin=0.0, vmax=1.0, cmap=MAP, aspect="auto")
    figure.colorbar(image, ax=axes, label="share [-]")
    given = settings(TerrainConfig, "terrain")
    labels = [_ground(name.removeprefix("terrain: "), given) for name in names]
    axes.set_xticks(range(len(names)), labels, fontsize=9)
    axes.set_yticks(range(len(robots)), robots)
    walk = f"{given.duration:.0f} s at {given.speed:g} m/s"
    axes.set_title(f"Blind walks of {walk} that were survived, {', '.join(robots)}", fontsize=11)
    return figure


def draw_ladder_curves(reports: Reports) -> Figure | None:
    """Shares survived over the levels of every ladder."""
    found = [report for (bench, _), report in reports.items() if bench == "terrain_ladder"]
    return draw_ladders(found) if found else None


def _ground(name: str, given: TerrainConfig) -> str:
    condition = (given.conditions | given.goals).get(name)
    words = [name.replace("_", " ")]
    if condition is not None:
        words += [f"{condition.friction:g}"] if condition.friction is not None else []
        words += [f"{100.0 * condition.payload:g} %"] if condition.payload else []
        words += [f"+{1e3 * condition.delay:g} ms"] if condition.delay else []
        words += [f"{condition.speed:g} m/s"] if condition.speed else []
    return "\n".join(words)
