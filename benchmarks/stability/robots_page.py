"""Markdown pages of the robots: results of each robot with a picture of those that walk, and long runs."""

import re
import warnings
from pathlib import Path
from typing import Any

from benchmarks.core.harness import Case
from bridge.record.render import run_renderer

TABLE, RUNS, PICTURE = "robots_table.md", "robots_trials.md", "img/robots.jpg"  #: Files of the pages and of the picture
TRIALS = ("stand", "squat", "wave", "walk", "push")  #: Trials of ``poise check-robot``
PICTURE_TIME = 60.0  #: Maximum time for the picture of one robot [s]
_HEAD = ("robot", "mass", "legs", *TRIALS, "time of the check", "limits")
_TABLE_TEXT = f"""\
# Robots from their files alone

Results of `poise check-robot` ([robots.md](robots.md)), written by `poise bench robots --plot docs`: all URDF and MJCF
files of the installed packages with two legs, and the generated robots of `benchmarks/stability/humanoids.py`. One
seed. The robots that walk, in single support:

![walking robots]({PICTURE})

"""
_RUNS_TEXT = """\
# Long runs

Successful runs over all seeds, written by `poise bench robots --mode trials --plot docs` with `--first-seed` and a
`--scenario` for each robot.

"""


def write_page(cases: list[Case], folder: Path, *, long: bool) -> list[Path]:
    """Write the page of the robots and its picture, or the page of ``long`` runs; returns the files."""
    file = folder / (RUNS if long else TABLE)
    lines = trial_rows(cases) if long else rows(cases)
    file.write_text((_RUNS_TEXT if long else _TABLE_TEXT) + "\n".join(lines) + "\n", encoding="utf-8")
    return [file] if long else [file, *_draw(cases, folder / PICTURE)]


def _draw(cases: list[Case], picture: Path) -> list[Path]:
    """Draw the picture of the robots that walk; warns with the reason if there is none."""
    names = [case["robot"] for case in cases if case.get("trials", {}).get("walk", [False])[0]]
    picture.parent.mkdir(parents=True, exist_ok=True)
    module, timeout = "benchmarks.stability.robot_pictures", PICTURE_TIME * len(names)
    if names and not (error := run_renderer(module, [str(picture), *dict.fromkeys(names)], picture, timeout)):
        return [picture]
    warnings.warn(error if names else "no pictures: no robot walks", stacklevel=2)
    return []


def rows(cases: list[Case]) -> list[str]:
    """Return the table of the robots, followed by the refused files."""
    tried, lines = [case for case in cases if "trials" in case], _table(_HEAD)
    for case in tried:
        trials: dict[str, Any] = case["trials"]
        words = [_word(trials[each]) if each in trials else "-" for each in TRIALS]
        if not case["arms"]:
            words[TRIALS.index("wave")] = "no arm"
        name = f"`{case['robot']}`" if "/" in case["robot"] else case["robot"]
        limits = "; ".join(case["limits"]).replace("|", "/")
        cells = name, f"{case['mass']:.0f} kg", f"{case['legs']} joints", *words, f"{case['time']:.0f} s", limits
        lines.append(f"| {' | '.join(cells)} |")
    refused: dict[str, list[str]] = {}  # by reason, without the quoted names
    for case in (case for case in cases if "refused" in case):
        refused.setdefault(re.sub(r"'[^']*'", "...", case["refused"]), []).append(f"`{case['robot']}`")
    names = [f"- {reason}: {', '.join(names)}" for reason, names in refused.items()]
    return [*lines, "", "Refused:", "", *names] if names else lines


def trial_rows(cases: list[Case]) -> list[str]:
    """Return the table of the long runs."""
    names = list(dict.fromkeys(case["trial"] for case in cases))
    lines = _table(("robot", *names, "all", "failures"))
    for robot in dict.fromkeys(case["robot"] for case in cases):
        own = [case for case in cases if case["robot"] == robot]
        cells = [_share([case for case in own if case["trial"] == name]) for name in names]
        failed = [f"{case['trial']}, seed {case['seed']}: {case['reason']}" for case in own if not case["passed"]]
        lines.append(f"| {' | '.join((robot, *cells, _share(own), '; '.join(failed)))} |")
    return lines


def _share(cases: list[Case]) -> str:
    return f"{sum(case['passed'] for case in cases)} of {len(cases)}"


def _table(head: tuple[str, ...]) -> list[str]:
    return [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]


def _word(trial: list[Any]) -> str:
    """Return the text of a trial in a cell: its first figure, or 'no' if it failed."""
    passed, detail = trial
    figure = detail.partition(", ")[0]
    return figure.partition(": ")[2] or figure if passed else "no"
