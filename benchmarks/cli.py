"""``poise bench NAME``: the command line of every benchmark."""

from __future__ import annotations

from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmarks.cli_options import JsonFile, PlotFolder, ResultsPath, Robot, Scheduler, Seeds, Workers, sweep_of
from benchmarks.suite_cli import add_suite
from models.errors import ConfigError, PoiseError

app = typer.Typer(no_args_is_help=True, help="Measure speed and stability; exits 0 only when every bound holds.")

CONTENDER_HELP = "Test another controller instead of poise's, module:Class; docs/contenders.md."

MODULES: dict[str, str] = {}
"""Module in this folder that measures and draws each benchmark, by the name that its reports bear.

It is filled where the commands are added.
"""


CONTESTED = ("push", "terrain", "walk")
"""Benchmarks that take other controllers."""


class PushMode(StrEnum):
    """What a robot that is pushed does meanwhile."""

    STAND = "stand"
    STEP = "step"
    WALK = "walk"


def _bench(
    module_name: str,
    robot: str,
    seeds: int,
    workers: int,
    scheduler: str,
    results: Path | None,
    json: Path | None,
    plot: Path | None,
    scenarios: tuple[str, ...] = (),
    mode: str = "",
    contender: str = "",
) -> None:
    """Run one benchmark, write what was asked for, exit with its verdict."""
    from benchmarks.harness import Options, print_report, write_json

    console = Console()
    module = import_module(f"benchmarks.{module_name}")
    try:
        if contender and module_name.removesuffix("_map") not in CONTESTED:  # push_map refuses it itself, by its mode
            raise ConfigError(f"bench {module_name} takes no contender; these do: {', '.join(CONTESTED)}")
        with sweep_of(workers, scheduler, results) as sweep:
            report = module.run(Options(robot, seeds, workers, scenarios, mode, contender, sweep=sweep))
            if sweep.results is not None:
                console.print(f"{sweep.results.found} cases were there, {sweep.results.added} measured: {results}")
    except PoiseError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        raise typer.Exit(2) from error
    if contender:
        report.notes.insert(0, f"contender: {contender}")
    print_report(report, console)
    if json is not None:
        write_json(report, json)
        console.print(f"report: {json}")
    if plot is not None:
        plot.mkdir(parents=True, exist_ok=True)
        for file in module.plot(report, plot):
            console.print(f"plot: {file}")
    raise typer.Exit(0 if report.passed else 1)


def _add_command(name: str, help_text: str, *, usual_seeds: int = 1) -> None:
    """Give the benchmark ``benchmarks/<name>.py`` a command with the options that all of them share.

    Args:
        name: Name of the module and of the command.
        help_text: What ``--help`` says about it.
        usual_seeds: How many seeds unless the user says otherwise.
    """
    MODULES[name] = name

    @app.command(name, help=help_text)
    def run(
        robot: Robot = "g1",
        seeds: Seeds = usual_seeds,
        workers: Workers = 1,
        scheduler: Scheduler = "",
        results: ResultsPath = None,
        json: JsonFile = None,
        plot: PlotFolder = None,
    ) -> None:
        _bench(name, robot, seeds, workers, scheduler, results, json, plot)


def _add_scenarios(name: str, help_text: str, *, usual_seeds: int = 20) -> None:
    """The same for a benchmark of scenarios that can be chosen; an unknown one is refused with those there are.

    Those that take no contender do not offer one either, but say so to who asks.
    """
    MODULES[name] = name

    @app.command(name, help=help_text)
    def run(
        robot: Robot = "g1",
        seeds: Seeds = usual_seeds,
        workers: Workers = 1,
        scheduler: Scheduler = "",
        results: ResultsPath = None,
        json: JsonFile = None,
        plot: PlotFolder = None,
        scenario: Annotated[list[str] | None, typer.Option(help="Measure only this one; repeatable.")] = None,
        contender: str = typer.Option("", help=CONTENDER_HELP, hidden=name not in CONTESTED),
    ) -> None:
        chosen = tuple(scenario or ())
        _bench(name, robot, seeds, workers, scheduler, results, json, plot, chosen, contender=contender)


_add_command("tick", "Time of one whole-body tick, beside placo's solver and the bare Pinocchio calls.")
_add_command("qp", "QPs of real ticks: the tick's own solver beside the back-ends of qpsolvers, with residuals.")
_add_command("gait", "Time of gait planner, step adjustment and whole-body tick in single support, while walking.")
_add_command("loop", "Speed of the whole closed loop on one core, standing and walking, and where its time goes.")

MODULES |= {"push": "push", **{f"push_{mode}": "push_map" for mode in (PushMode.STEP, PushMode.WALK)}}


@app.command("push")
def push(
    robot: Robot = "g1",
    seeds: Seeds = 1,
    workers: Workers = 1,
    scheduler: Scheduler = "",
    results: ResultsPath = None,
    json: JsonFile = None,
    plot: PlotFolder = None,
    mode: Annotated[
        PushMode, typer.Option(help="Standing without a step, standing with steps, or walking.")
    ] = PushMode.STAND,
    direction: Annotated[list[str] | None, typer.Option(help="Push only this way, such as left; repeatable.")] = None,
    contender: Annotated[str, typer.Option(help=CONTENDER_HELP)] = "",
) -> None:
    """Largest push at the pelvis that is taken, in 8 directions, beside the bounds of ankles and steps."""
    module = MODULES["push" if mode is PushMode.STAND else f"push_{mode}"]
    chosen = tuple(direction or ())
    _bench(module, robot, seeds, workers, scheduler, results, json, plot, chosen, mode.value, contender)


@app.command("draw")
def draw(
    report: Annotated[Path, typer.Argument(help="What --json of a benchmark wrote.")],
    folder: Annotated[Path, typer.Argument(help="Where the plots go.")],
) -> None:
    """Draw the plots of a report again, without measuring anything."""
    from benchmarks.harness import read_json

    console = Console()
    try:
        found = read_json(report)
        if found.bench not in MODULES:
            raise ConfigError(f"{report}: unknown benchmark '{found.bench}'; known: {', '.join(MODULES)}")
    except PoiseError as error:
        console.print(str(error), style="red", markup=False, soft_wrap=True)
        raise typer.Exit(2) from error
    folder.mkdir(parents=True, exist_ok=True)
    for file in import_module(f"benchmarks.{MODULES[found.bench]}").plot(found, folder):
        console.print(f"plot: {file}", soft_wrap=True)


_add_command("stand", "A minute of quiet standing, and wave and squat while pushed, for every seed.", usual_seeds=20)


_add_scenarios("walk", "Walking at commanded velocities: falls, speed error, cost of transport, top speed, stopping.")
_add_scenarios("faults", "Faults of sensors, motors, solver, users and world, and what the robot does.", usual_seeds=1)
_add_scenarios(
    "graph_faults", "Faults of processes, topics and host, done to the real graph in real time.", usual_seeds=1
)
_add_command("endurance", "An hour of random commands and pushes: falls, latched faults, memory.")
_add_scenarios("terrain", "Blind walking on tiles, slopes and slippery ground, with a payload and with late commands.")
_add_scenarios(
    "latency",
    "Sensor stamp to command received over ROS 2, stage by stage, beside a ping-pong of the same messages.",
    usual_seeds=1,
)
_add_command("calibrate", "Injected sensor errors: what calibration leaves of them, and how the robot then stands.")
_add_command("estimate", "Error of the state estimator, and whether its covariance is honest.", usual_seeds=20)
_add_command("scaling", "The same cases over one worker and over two: speed-up, cost of a case, hours of 100 000.")
add_suite(app, MODULES)
