"""``poise``: the command line. Modules are imported by the command that needs them, so that help is immediate."""

from __future__ import annotations

import os
from importlib.metadata import entry_points, version
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

# One thread per process, set before anything numerical is imported; pictures without a display.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
os.environ.setdefault("MUJOCO_GL", "egl")

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    help="Whole-body control for humanoid robots over ROS 2.",
)
for _entry in entry_points(group="poise.commands"):
    app.add_typer(_entry.load(), name=_entry.name)

Robot = Annotated[str, typer.Option(help="Robot profile, by name or path.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"poise {version('poise')}")
        raise typer.Exit


@app.callback()
def _options(
    _: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options of the command line itself."""


@app.command()
def robots() -> None:
    """List the robots that have a profile."""
    import pinocchio as pin

    from models.profile import robot_names
    from models.robot_model import RobotModel

    table = Table("name", "joints", r"mass \[kg]", r"CoM height \[m]", r"sole \[cm]")
    for name in robot_names():
        model = RobotModel.load(name)
        x_min, x_max, y_min, y_max = model.feet[0].rectangle
        sole = f"{100 * (x_max - x_min):.1f} x {100 * (y_max - y_min):.1f}"
        height = pin.centerOfMass(model.pin, model.data(), model.standing_configuration())[2]
        table.add_row(name, str(model.nj), f"{model.mass:.1f}", f"{height:.3f}", sole)
    Console().print(table)
