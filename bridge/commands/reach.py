"""``poise reach``: a hand to a place."""

from __future__ import annotations

from typing import Annotated

import typer

from bridge.commands.common import Namespace, Network, need_ros, print_reply, report_errors


def reach(
    frame: Annotated[str, typer.Argument(help="left_hand, right_hand, head, base_link or torso.")],
    x: Annotated[float, typer.Argument(help=r"Forward \[m].")],
    y: Annotated[float, typer.Argument(help=r"Left \[m].")],
    z: Annotated[float, typer.Argument(help=r"Up \[m].")],
    of: Annotated[
        str, typer.Option("--in", help="Frame of the target: odom, base_footprint, or one of the robot.")
    ] = "base_link",
    duration: Annotated[float, typer.Option(min=0.0, help=r"Time to get there; 0: as short as can be \[s].")] = 0.0,
    plan_only: Annotated[bool, typer.Option("--plan-only", help="Say whether and how fast; nothing moves.")] = False,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Have the standing robot bring a hand, its head or its pelvis to a place, or say why it cannot."""
    need_ros()
    from bridge.ros.client import Client
    from bridge.ros.walk import reach as go

    with report_errors(), Client(network=network, namespace=namespace) as client:
        reply = go(client, frame, (x, y, z), frame_id=of, duration=duration, execute=not plan_only)
    raise typer.Exit(print_reply(reply))
