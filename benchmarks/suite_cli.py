"""``poise bench all`` and ``poise bench report``: all benchmarks, and their report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmarks.cli_options import Scheduler, Workers, sweep_of
from models.errors import PoiseError

Quick = Annotated[bool, typer.Option("--quick/--full", help="Minutes with few cases, or hours with all of them.")]
Folder = Annotated[Path, typer.Option("--out", help="Where cases, report and plots go; a rerun goes on there.")]


def add_suite(app: typer.Typer, modules: Mapping[str, str]) -> None:
    """Give the command line its commands for all benchmarks.

    Args:
        app: The command line.
        modules: Module of each benchmark, by the name that its reports bear.
    """

    @app.command("all")
    def run_all(
        quick: Quick = True,
        out: Folder = Path("out/bench"),
        workers: Workers = 2,
        scheduler: Scheduler = "",
    ) -> None:
        """All benchmarks: cases in JSON lines, a Markdown and an HTML report with plots; it goes on where it ended."""
        from benchmarks.report_page import write_report
        from benchmarks.saved_reports import CASES
        from benchmarks.suite import run_suite, suite_config

        console, suites = Console(), suite_config()
        name, entries = ("quick", suites.quick) if quick else ("full", suites.full)
        try:
            with sweep_of(workers, scheduler, out / CASES) as sweep:
                passed = run_suite(entries, modules, out, sweep, console, name)
                if sweep.results is not None:
                    console.print(f"{sweep.results.found} cases were there, {sweep.results.added} measured")
            files = write_report(out)
        except PoiseError as error:
            console.print(str(error), style="red", markup=False, soft_wrap=True)
            raise typer.Exit(2) from error
        console.print(f"report: {files[0]}, {files[1]}", soft_wrap=True)
        raise typer.Exit(0 if passed else 1)

    @app.command("report")
    def rebuild(
        folder: Annotated[Path, typer.Argument(help="What --out of all named.")],
        docs: Annotated[
            Path | None, typer.Option(help="Write page, plots and figures here instead, as a repository keeps them.")
        ] = None,
    ) -> None:
        """Build the report of all benchmarks again from their JSON lines, without measuring anything."""
        from benchmarks.report_page import publish_report, write_report
        from benchmarks.suite_plan import read_progress

        console = Console()
        try:
            files = write_report(folder) if docs is None else publish_report(folder, docs)
            progress = read_progress(folder)
        except PoiseError as error:
            console.print(str(error), style="red", markup=False, soft_wrap=True)
            raise typer.Exit(2) from error
        for file in files:
            console.print(f"written: {file}", soft_wrap=True)
        if progress.missing:
            console.print(str(progress), style="yellow", soft_wrap=True)
