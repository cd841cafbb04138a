"""``poise tune``: search for parameters of the laws."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich import progress
from rich.console import Console
from rich.table import Table

from benchmarks.cli import Scheduler, Workers, open_sweep, report_errors

app = typer.Typer()


@app.command()
def tune(
    search: Annotated[str, typer.Argument(help="YAML file of the search, or the name of a packaged one.")] = "recovery",
    robot: Annotated[str, typer.Option(help="Robot profile, by name or path.")] = "g1",
    out: Annotated[Path | None, typer.Option(help="Profile to write; out/tune/ROBOT.yaml by default.")] = None,
    results: Annotated[
        Path | None, typer.Option(help="File of finished scenarios, to resume the search; beside --out by default.")
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", help="Write a plot into this folder.")] = None,
    workers: Workers = 1,
    scheduler: Scheduler = "",
) -> None:
    """Search parameters of the laws in random scenarios, and write a profile with them; docs/tune.md.

    Exits 0 only when nothing got worse on scenarios that the search has not seen.
    """
    from benchmarks.core.harness import Options
    from benchmarks.core.results import check_file, check_folder, writing
    from benchmarks.tuning.config import load_tune_config
    from benchmarks.tuning.report import check_output, draw_search, table, verdict, write_overlay
    from benchmarks.tuning.tune import Generation
    from benchmarks.tuning.tune import tune as run

    console = Console()
    file = out or Path("out/tune") / f"{Path(robot).stem}.yaml"
    done: list[Generation] = []
    shown = (progress.MofNCompleteColumn(), progress.TimeElapsedColumn(), progress.TimeRemainingColumn())
    columns = (progress.TextColumn("{task.description}"), progress.BarColumn(), *shown)

    def ended(each: Generation) -> None:
        done.append(each)
        values = ", ".join(f"{name} {value:g}" for name, value in each.parameters.items())
        text = (
            f"generation {len(done)} of {config.generations}: loss {each.losses[0]:.3f} to {each.losses[-1]:.3f} of "
            f"the best {len(each.losses)}, {each.measured} of {each.total} scenarios; {values}"
        )
        console.print(text, soft_wrap=True, highlight=False)

    with report_errors(console):
        config = load_tune_config(search)
        check_output(file, robot)
        check_file(file)
        if plot is not None:
            check_folder(plot)
        count = config.generations * config.population * config.total(config.scenarios)
        count += 2 * config.judged * config.total(config.kinds)
        with (
            open_sweep(workers, scheduler, results or file.with_suffix(".jsonl")) as sweep,
            progress.Progress(*columns, console=console) as bar,
        ):
            task = bar.add_task(f"tune {robot}", total=count)
            options = Options(robot, workers=workers, sweep=sweep)
            tuned = run(config, options, ended, lambda number: bar.advance(task, number))
        passed, words = verdict(config, tuned)
        with writing(file):
            write_overlay(file, robot, config, tuned)
    shown_table = Table("", "before", "after", title="scenarios that the search did not use", title_justify="left")
    for row in table(config, tuned):
        shown_table.add_row(*row)
    console.print(shown_table)
    for line in (words, f"cost: {tuned.cost}", f"profile: {file}"):
        console.print(line, soft_wrap=True, highlight=False, markup=False)
    if plot is not None:
        console.print(f"plot: {draw_search(config, robot, tuned, plot)}", soft_wrap=True, highlight=False)
    raise typer.Exit(0 if passed else 1)
