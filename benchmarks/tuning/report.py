"""Report of ``poise tune``: table before and after, verdict, profile, and plot."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from matplotlib.ticker import MaxNLocator

from benchmarks.core.benchmark import saved
from benchmarks.core.harness import Case
from benchmarks.core.provenance import revision
from benchmarks.stability.falls import FAILED, PASSED
from benchmarks.tuning.config import TuneConfig, laws
from benchmarks.tuning.race import robust_loss
from benchmarks.tuning.scenarios import sector_name
from benchmarks.tuning.tune import Tuned
from bridge.analysis.plots import new_figure
from models.config import read_yaml
from models.errors import ConfigError
from models.profile import load_profile, robot_names


@dataclass(frozen=True, slots=True)
class Row:
    """Survived scenarios before and after, out of the same scenarios, for a kind or one of its sectors."""

    kind: str
    sector: str  #: Name of the sector; empty for the whole kind
    before: int
    after: int
    total: int

    @property
    def name(self) -> str:
        """Kind and sector as text."""
        return f"{self.kind}, {self.sector or 'all'}"


def compare(config: TuneConfig, tuned: Tuned) -> list[Row]:
    """Return the rows of every sector and kind in the judging scenarios."""

    def row(name: str, sector: int | None, words: str) -> Row:
        pairs = [
            (not was["reason"], not now["reason"])
            for was, now in zip(tuned.before, tuned.after, strict=True)
            if was["kind"] == name and sector in (None, was["sector"])
        ]
        return Row(name, words, sum(was for was, _ in pairs), sum(now for _, now in pairs), len(pairs))

    rows = []
    for name, kind in config.kinds.items():
        sectors = config.sectors(kind)
        if sectors > 1:
            rows += [row(name, k, sector_name(config, kind, k)) for k in range(sectors)]
        rows.append(row(name, None, ""))
    return rows


def judged_loss(config: TuneConfig, results: Sequence[Case]) -> float:
    """Return the robust loss of the judging scenarios."""
    return robust_loss(results, [case["loss"] for case in results], config.tail)


def verdict(config: TuneConfig, tuned: Tuned) -> tuple[bool, str]:
    """Return whether neither the loss nor the survival of a kind is worse by more than ``tolerance``, and a text.

    The p-value is from the two-sided sign test on the scenarios that only one of both survives.
    """
    gained = sum(bool(was["reason"]) > bool(now["reason"]) for was, now in zip(tuned.before, tuned.after, strict=True))
    lost = sum(bool(was["reason"]) < bool(now["reason"]) for was, now in zip(tuned.before, tuned.after, strict=True))
    tails = 2 * sum(math.comb(gained + lost, k) for k in range(min(gained, lost) + 1))
    chance = min(tails / 2 ** (gained + lost), 1.0)
    old, new = judged_loss(config, tuned.before), judged_loss(config, tuned.after)
    worse = [
        f"{row.kind} {row.before} before, {row.after} after"
        for row in compare(config, tuned)
        if not row.sector and row.after < (1.0 - config.tolerance) * row.before
    ]
    if new > (1.0 + config.tolerance) * old:
        worse.append(f"loss {old:.3f} before, {new:.3f} after")
    said = f"worse by more than {100.0 * config.tolerance:g} %"
    text = f"not passed, {said}: {'; '.join(worse)}" if worse else f"passed, nothing {said}"
    return not worse, f"{text}; scenarios gained {gained}, lost {lost} (sign test: p = {chance:.2g})"


def table(config: TuneConfig, tuned: Tuned) -> list[tuple[str, str, str]]:
    """Return rows of name, before and after: parameters, survived scenarios, loss."""
    rows = [(name, f"{tuned.start[name]:g}", f"{value:g}") for name, value in tuned.found.items()]
    rows += [(row.name, f"{row.before}/{row.total}", f"{row.after}/{row.total}") for row in compare(config, tuned)]
    old, new = judged_loss(config, tuned.before), judged_loss(config, tuned.after)
    return [*rows, ("loss", f"{old:.3f}", f"{new:.3f}")]


def check_output(path: Path, robot: str) -> None:
    """Raise ``ConfigError`` if the robot's profile is, or extends, the file to be written."""
    files = [Path(load_profile(robot).source)]
    while (extended := read_yaml(files[-1]).get("extends")) is not None:
        below = extended if extended in robot_names() else files[-1].parent / Path(extended).expanduser()
        files.append(Path(load_profile(below).source))
    if path.resolve() in [file.resolve() for file in files]:
        raise ConfigError(f"{path}: the profile of {robot} is, or extends, this file; name another one with --out")


def write_overlay(path: Path, robot: str, config: TuneConfig, tuned: Tuned) -> None:
    """Write a profile that extends the robot's with the found parameters; table, verdict and cost are comments."""
    path.parent.mkdir(parents=True, exist_ok=True)
    source = Path(load_profile(robot).source)
    extended = robot if robot in robot_names() else os.path.relpath(source, path.parent)
    text = yaml.safe_dump({"extends": extended, "laws": laws(tuned.found)}, sort_keys=False)
    lines = [f"{robot}, tuned by `poise tune` at revision {revision()}"]
    lines += [f"{what}: {was} before, {now} after" for what, was, now in table(config, tuned)]
    lines += [verdict(config, tuned)[1], tuned.cost]
    path.write_text("".join(f"# {line}".rstrip() + "\n" for line in lines) + text, encoding="utf-8")


def draw_search(config: TuneConfig, robot: str, tuned: Tuned, folder: Path) -> Path:
    """Plot loss and parameters over the generations, and survival before and after; returns the file."""
    rows = compare(config, tuned)
    figure = new_figure(10.0, 4.0 + 0.18 * len(rows))
    grid = figure.add_gridspec(2, 2, height_ratios=(3.0, 1.0 + 0.18 * len(rows)))
    generations = np.arange(1, len(tuned.history) + 1)
    axes = figure.add_subplot(grid[0, 0])
    axes.plot(generations, [each.losses[0] for each in tuned.history], color=PASSED, label="best candidate")
    means = [float(np.mean(each.losses)) for each in tuned.history]
    axes.plot(generations, means, color="0.4", label=f"mean of the best {config.best}")
    axes.set(xlabel="generation, each with other scenarios", ylabel="loss [-]")
    axes.set_ylim(bottom=0.0)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(fontsize=7, frameon=False)
    axes = figure.add_subplot(grid[0, 1])
    for name, (low, high) in config.parameters.items():
        values = [tuned.start[name], *(each.parameters[name] for each in tuned.history)]
        axes.plot([0, *generations], [(value - low) / (high - low) for value in values], label=name)
    axes.set(xlabel="generation", ylabel="mean, of the range [-]", ylim=(-0.05, 1.05))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(fontsize=6, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes = figure.add_subplot(grid[1, :])
    places = np.arange(len(rows))
    for off, label, colour in ((-0.2, "before", FAILED), (0.2, "after", PASSED)):
        shares = [getattr(row, label) / row.total for row in rows]
        axes.barh(places + off, shares, 0.4, color=colour, label=label)
    axes.set_yticks(places, [f"{row.name} ({row.total})" for row in rows], fontsize=7)
    axes.invert_yaxis()
    axes.set(xlim=(0.0, 1.0), xlabel="share survived of scenarios that the search did not use [-]")
    axes.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.suptitle(f"{robot}: {verdict(config, tuned)[1]}", fontsize=9)
    folder.mkdir(parents=True, exist_ok=True)
    return saved(figure, folder / f"tune-{Path(robot).stem}.png")
