"""``poise bench``: one command per benchmark of the catalogue, one for all benchmarks, and one for their report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from benchmarks.core.benchmark import Listed, catalogue
from models.errors import ConfigError, PoiseError

if TYPE_CHECKING:
    from benchmarks.core.harness import Sweep

app = typer.Typer(no_args_is_help=True, help="Measure speed and stability; exits 0 only when every bound holds.")

CONTENDER_HELP = "Test another controller instead of poise's: module:Class or policy.yaml; docs/contenders.md."
SIZE_HELP = "Apply only pushes of this impulse over mass [m/s], in every phase; by default the largest is searched."
DIRECTIONS_HELP = (
    "Number of evenly spread directions, and angle of the first [deg]: 16, or 8+22.5 (between those of 8)."
)

Workers = Annotated[int, typer.Option(min=1, help="Number of processes that run cases in parallel.")]
Scheduler = Annotated[
    str, typer.Option(help="Run the cases on workers of this dask scheduler, such as tcp://HOST:8786.")
]
ResultsPath = Annotated[
    Path | None, typer.Option("--results", help="File of finished cases; cases that it already contains are skipped.")
]


@contextmanager
def open_sweep(workers: int, scheduler: str, results: Path | None) -> Iterator[Sweep]:
    """Open the executor (this machine or a dask ``scheduler``) and the optional file of finished cases as a context."""
    from benchmarks.core.harness import Sweep, make_executor
    from benchmarks.core.results import ResultsFile

    with ExitStack() as stack:
        file = None if results is None else stack.enter_context(ResultsFile(results))
        yield Sweep(stack.enter_context(make_executor(workers, scheduler)), file)


@contextmanager
def report_errors(console: Console) -> Iterator[None]:
    """Print a ``PoiseError`` as one line and exit with status 2."""
    try:
        yield
    except PoiseError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        raise typer.Exit(2) from error


def _add_command(name: str, modes: Sequence[Listed]) -> None:
    """Add the command of one benchmark, or of several that differ in ``--mode``; the first mode is the default."""
    first = modes[0].info
    choice = first.choice or "scenario"
    degrees = " (or degrees to the left)" if choice == "direction" else ""
    known = {each.info.mode: each for each in modes}
    usual = ", ".join(dict.fromkeys(str(each.info.seeds) for each in modes))

    @app.command(name, help=first.about)
    def run(
        robot: Annotated[str, typer.Option(help="Robot profile.")] = "g1",
        seeds: int | None = typer.Option(None, min=1, help=f"Number of seeds; {usual} by default."),
        first_seed: Annotated[int | None, typer.Option(min=0, help="First seed; 0 by default.")] = None,
        workers: Workers = 1,
        scheduler: Scheduler = "",
        results: ResultsPath = None,
        json: Annotated[Path | None, typer.Option("--json", help="Write the report here.")] = None,
        plot: Annotated[Path | None, typer.Option("--plot", help="Write plots into this folder.")] = None,
        mode: str = typer.Option(
            first.mode,
            help=" ".join(f"{mode}: {each.info.about}" for mode, each in known.items()),
            hidden=len(known) < 2,
        ),
        chosen: list[str] = typer.Option(  # noqa: B008
            [],
            f"--{choice}",
            help=f"Measure only this {choice}{degrees}; repeatable.",
            hidden=not first.choice,
        ),
        directions: str = typer.Option("", help=DIRECTIONS_HELP, hidden=choice != "direction"),
        size: float = typer.Option(0.0, min=0.0, help=SIZE_HELP, hidden=choice != "direction"),
        contender: str = typer.Option("", help=CONTENDER_HELP, hidden=not first.contender),
    ) -> None:
        from benchmarks.core.harness import Options, print_report, write_json
        from benchmarks.core.results import check_file, check_folder, writing

        if mode not in known:
            raise typer.BadParameter(f"'{mode}' is not one of: {', '.join(known)}", param_hint="--mode")
        console, listed = Console(), known[mode]
        with report_errors(console):
            if contender and not listed.info.contender:
                others = ", ".join(dict.fromkeys(each.command for each in catalogue().values() if each.info.contender))
                raise ConfigError(f"bench {name} has no --contender; these benchmarks have: {others}")
            if chosen and not first.choice:
                raise ConfigError(f"bench {name} has no --{choice}: it always runs all cases")
            if size and choice != "direction":
                raise ConfigError(f"bench {name} has no --size: it applies no pushes")
            if directions and choice != "direction":
                raise ConfigError(f"bench {name} has no --directions: it applies no pushes")
            if json is not None:
                check_file(json)
            if plot is not None:
                check_folder(plot)
            benchmark = listed.load()
            with open_sweep(workers, scheduler, results) as sweep:
                chose = tuple(chosen)
                number = listed.info.seeds if seeds is None else seeds
                options = Options(robot, number, first_seed, workers, chose, directions, size, contender, sweep)
                report = benchmark.run(options)
                if sweep.results is not None:
                    console.print(
                        f"{sweep.results.found} cases already finished, {sweep.results.added} measured: {results}"
                    )
        if contender:
            report.notes.insert(0, f"contender: {contender}")
        print_report(report, console)
        if json is not None:
            with report_errors(console), writing(json):
                write_json(report, json)
            console.print(f"report: {json}", soft_wrap=True)
        if plot is not None:
            with report_errors(console), writing(plot):
                files = benchmark.plots(report, plot)
            for file in files:
                console.print(f"plot: {file}", soft_wrap=True)
        raise typer.Exit(0 if report.passed else 1)


@app.command("draw")
def draw(
    report: Annotated[Path, typer.Argument(help="Report that a benchmark wrote with --json.")],
    folder: Annotated[Path, typer.Argument(help="Folder for the plots.")],
) -> None:
    """Draw the plots of a report again, without measuring anything."""
    from benchmarks.core.harness import read_json
    from benchmarks.core.results import check_folder

    console = Console()
    with report_errors(console):
        found = read_json(report)
        if found.bench not in catalogue():
            raise ConfigError(f"{report}: unknown benchmark '{found.bench}'; known: {', '.join(catalogue())}")
        check_folder(folder)
    for file in catalogue()[found.bench].load().plots(found, folder):
        console.print(f"plot: {file}", soft_wrap=True)


for _name, _modes in groupby(catalogue().values(), key=lambda each: each.command):
    _add_command(_name, list(_modes))


@app.command("all")
def run_all(
    quick: Annotated[
        bool, typer.Option("--quick/--full", help="Few cases, in minutes, or all cases, in hours.")
    ] = True,
    out: Annotated[
        Path, typer.Option("--out", help="Folder for cases, report and plots; a rerun resumes there.")
    ] = Path("out/bench"),
    workers: Workers = 2,
    scheduler: Scheduler = "",
) -> None:
    """Run all benchmarks and write cases (JSON lines), a Markdown and an HTML report, and plots; a rerun resumes."""
    from benchmarks.core.results import writing
    from benchmarks.report.report_page import write_report
    from benchmarks.report.suite import CASES, parts_of, run_suite

    console, name = Console(), "quick" if quick else "full"
    with report_errors(console):
        with open_sweep(workers, scheduler, out / CASES) as sweep:
            passed = run_suite(parts_of(name), catalogue(), out, sweep, console, name)
            if sweep.results is not None:
                console.print(f"{sweep.results.found} cases already finished, {sweep.results.added} measured")
        with writing(out):
            files = write_report(out)
    console.print(f"report: {files[0]}, {files[1]}", soft_wrap=True)
    raise typer.Exit(0 if passed else 1)


@app.command("report")
def report(
    folder: Annotated[Path, typer.Argument(help="Folder of poise bench all, its --out.")],
    docs: Annotated[
        Path | None,
        typer.Option(help="Write page, plots and figures to this folder instead, without cases, for a repository."),
    ] = None,
) -> None:
    """Build the report of all benchmarks again from their JSON lines, without measuring anything."""
    from benchmarks.core.results import writing
    from benchmarks.report.report_page import publish_report, write_report
    from benchmarks.report.suite import read_progress

    console = Console()
    with report_errors(console), writing(docs or folder):
        files = write_report(folder) if docs is None else publish_report(folder, docs)
        progress = read_progress(folder)
    for file in files:
        console.print(f"written: {file}", soft_wrap=True)
    if progress.missing:
        console.print(str(progress), style="yellow", soft_wrap=True)
