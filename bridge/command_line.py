"""What the commands of ``poise`` share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from models.types import CommandReply

Network = Annotated[bool, typer.Option(help="The robot may run on another machine.")]
Namespace = Annotated[str, typer.Option(help="Namespace of the robot, such as robot_1.")]


def need_ros() -> None:
    """End with advice when there is no rclpy."""
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        advice = "pip install 'poise[ros]' (x86-64 Linux), or source a ROS 2 Jazzy"
        Console(stderr=True).print(f"rclpy cannot be imported ({error}): {advice}", markup=False)
        raise typer.Exit(2) from error


def need(module: str, extra: str) -> None:
    """End with advice when an optional package is absent.

    Args:
        module: Name that is imported.
        extra: Of ``poise`` that brings it.
    """
    if find_spec(module) is None:
        advice = f"pip install 'poise[{extra}]'"
        Console(stderr=True).print(f"'{module}' is not installed: {advice}", markup=False)
        raise typer.Exit(2)


def print_reply(reply: CommandReply) -> int:
    """Print the answer of the robot; returns the exit status."""
    Console().print(reply.reason, style="green" if reply.accepted else "red", markup=False, highlight=False)
    if reply.details:
        table = Table("quantity", "value")
        for name, value in reply.details.items():
            table.add_row(escape(name), f"{value:.6g}")
        Console().print(table)
    return 0 if reply.accepted else 1


@contextmanager
def told() -> Iterator[None]:
    """Print an error of poise as one line and end with status 2."""
    from models.errors import PoiseError

    try:
        yield
    except PoiseError as error:
        Console(stderr=True).print(str(error), style="red", markup=False, highlight=False)
        raise typer.Exit(2) from error
