"""What the commands of ``poise bench`` share: their options, and the sweep that these ask for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from benchmarks.harness import Sweep

Robot = Annotated[str, typer.Option(help="Robot profile.")]
Seeds = Annotated[int, typer.Option(min=1, help="How many seeds.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes that measure at the same time.")]
Scheduler = Annotated[str, typer.Option(help="Measure by the workers of this dask scheduler, such as tcp://HOST:8786.")]
ResultsPath = Annotated[
    Path | None, typer.Option("--results", help="Keep finished cases in this file, and skip those that are there.")
]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Write the report here.")]
PlotFolder = Annotated[Path | None, typer.Option("--plot", help="Write plots into this folder.")]


@contextmanager
def sweep_of(workers: int, scheduler: str, results: Path | None) -> Iterator[Sweep]:
    """What measures the cases and keeps them, for as long as the context lasts.

    Args:
        workers: Processes of this machine, where no scheduler is named.
        scheduler: Address of a dask scheduler; empty for none.
        results: File of finished cases; None to keep none.

    Raises:
        PoiseError: dask is not installed, or the file is in use or damaged.
    """
    from benchmarks.executors import make_executor
    from benchmarks.harness import Sweep
    from benchmarks.results import ResultsFile

    with ExitStack() as stack:
        file = None if results is None else stack.enter_context(ResultsFile(results))
        yield Sweep(stack.enter_context(make_executor(workers, scheduler)), file)
