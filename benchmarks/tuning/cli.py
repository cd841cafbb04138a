"""``poise tune``: search parameters of the laws."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
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
        Path | None, typer.Option(help="Finished scenarios; the search goes on from there. Beside --out by default.")
    ] = None,
    workers: Workers = 1,
    scheduler: Scheduler = "",
) -> None:
    """Search parameters of the laws on random pushes, and write a profile with them; docs/tune.md."""
    from benchmarks.core.harness import Options
    from benchmarks.tuning.tune import Parameters, compare, load_tune_config, present, write_overlay
    from benchmarks.tuning.tune import tune as run

    console = Console()
    file = out or Path("out/tune") / f"{Path(robot).stem}.yaml"

    def progress(generation: int, losses: Sequence[float], mean: Parameters) -> None:
        values = ", ".join(f"{name} {value:g}" for name, value in mean.items())
        text = f"generation {generation + 1} of {config.generations}: loss {min(losses):.3f} to {max(losses):.3f}"
        console.print(f"{text}; {values}", soft_wrap=True, highlight=False)

    with report_errors(console):
        config = load_tune_config(search)
        before = present(config, robot)
        with open_sweep(workers, scheduler, results or file.with_suffix(".jsonl")) as sweep:
            found, (old, new) = run(config, Options(robot, workers=workers, sweep=sweep), progress)
        rows = [(name, f"{before[name]:g}", f"{value:g}") for name, value in found.items()]
        rows += compare(config, old, new)
        write_overlay(file, robot, found, [f"{what}: {was} before, {now} after" for what, was, now in rows])
    table = Table("", "before", "after", title="pushes taken that the search has not seen", title_justify="left")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    console.print(f"profile: {file}", soft_wrap=True)
