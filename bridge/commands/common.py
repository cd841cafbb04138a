"""Shared functions of the commands of ``poise``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from bridge.ros.client import Client
    from controllers.commands.command_signature import Signer
    from models.types import CommandReply

Network = Annotated[bool, typer.Option(help="Also find robots on other machines.")]
say = typer.echo  #: Prints plain text without wrapping
Namespace = Annotated[str, typer.Option(help="Namespace of the robot, such as robot_1.")]


def console(**options: Any) -> Console:
    """Create a rich console; rich is imported only by commands that print."""
    from rich.console import Console

    return Console(**options)


def need(module: str, advice: str) -> None:
    """Exit with advice when a module cannot be imported."""
    try:
        import_module(module)
    except ImportError as error:
        console(stderr=True).print(f"{module} cannot be imported ({error}): {advice}", markup=False)
        raise typer.Exit(2) from error


def need_ros() -> None:
    """Exit with advice when rclpy is missing."""
    need("rclpy", "pip install 'poise[ros]' (x86-64 Linux), or source ROS 2 Jazzy")


def print_reply(reply: CommandReply) -> int:
    """Print the answer of the robot; returns the exit status."""
    typer.secho(reply.reason, fg="green" if reply.accepted else "red")  # rich takes long to import
    if reply.details:
        from rich.markup import escape
        from rich.table import Table

        table = Table("quantity", "value")
        for name, value in reply.details.items():
            table.add_row(escape(name), f"{value:.6g}")
        console().print(table)
    return 0 if reply.accepted else 1


def signer_of(key: Path | None, source: str = "teleop") -> Signer | None:
    """Signer of the commands of a source; None without a key."""
    if key is None:
        return None
    from controllers.commands.command_signature import Signer, read_key

    return Signer(read_key(key), source)


@contextmanager
def connected(network: bool, namespace: str, key: Path | None = None, source: str = "teleop") -> Iterator[Client]:
    """Client of the running robot; it signs text commands when a key is given."""
    signer = signer_of(key, source)
    need_ros()
    from bridge.ros.client import Client

    with Client(network=network, namespace=namespace, signer=signer) as client:
        yield client
