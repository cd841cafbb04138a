"""``poise bench NAME``: the command line of every benchmark."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from models.errors import PoiseError

app = typer.Typer(no_args_is_help=True, help="Measure speed and stability; exits 0 only when every bound holds.")

Robot = Annotated[str, typer.Option(help="Robot profile.")]
Seeds = Annotated[int, typer.Option(min=1, help="How many seeds.")]
Workers = Annotated[int, typer.Option(min=1, help="Processes that measure at the same time.")]
JsonFile = Annotated[Path | None, typer.Option("--json", help="Write the report here.")]
PlotFolder = Annotated[Path | None, typer.Option("--plot", help="Write plots into this folder.")]


def _bench(name: str, robot: str, seeds: int, workers: int, json: Path | None, plot: Path | None) -> None:
    """Run one benchmark, write what was asked for, exit with its verdict."""
    from benchmarks.harness import Options, print_report, write_json

    console = Console()
    module = importlib.import_module(f"benchmarks.{name}")
    try:
        report = module.run(Options(robot=robot, seeds=seeds, workers=workers))
    except PoiseError as error:
        console.print(f"[red]{error}[/red]")
        raise typer.Exit(2) from error
    print_report(report, console)
    if json is not None:
        write_json(report, json)
        console.print(f"report: {json}")
    if plot is not None:
        plot.mkdir(parents=True, exist_ok=True)
        for file in module.plot(report, plot):
            console.print(f"plot: {file}")
    raise typer.Exit(0 if report.passed else 1)


@app.command()
def tick(
    robot: Robot = "g1",
    seeds: Seeds = 1,
    workers: Workers = 1,
    json: JsonFile = None,
    plot: PlotFolder = None,
) -> None:
    """Time of one whole-body tick, beside placo's solver and the bare Pinocchio calls."""
    _bench("tick", robot, seeds, workers, json, plot)


@app.command()
def push(
    robot: Robot = "g1",
    seeds: Seeds = 1,
    workers: Workers = 1,
    json: JsonFile = None,
    plot: PlotFolder = None,
) -> None:
    """Largest push at the pelvis taken without a step, in 8 directions, beside the ankle bound."""
    _bench("push", robot, seeds, workers, json, plot)


@app.command()
def stand(
    robot: Robot = "g1",
    seeds: Seeds = 20,
    workers: Workers = 1,
    json: JsonFile = None,
    plot: PlotFolder = None,
) -> None:
    """A minute of quiet standing, and wave and squat while pushed, for every seed."""
    _bench("stand", robot, seeds, workers, json, plot)


@app.command()
def latency(
    robot: Robot = "g1",
    seeds: Seeds = 1,
    workers: Workers = 1,
    json: JsonFile = None,
    plot: PlotFolder = None,
) -> None:
    """Sensor stamp to command received over ROS 2, beside a ping-pong of the same messages."""
    _bench("latency", robot, seeds, workers, json, plot)
