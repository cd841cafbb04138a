"""``poise log WHAT``: logs of a running robot, written on request."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from bridge.command_line import need_ros, told

app = typer.Typer(no_args_is_help=True, help="Write logs of the running robot.")


@app.callback()
def _options() -> None:
    """Keep ``imu`` a command of its own, however many there are."""


@app.command()
def imu(
    csv: Annotated[Path | None, typer.Option("--csv", help="Write a table here.")] = None,
    mcap: Annotated[Path | None, typer.Option("--mcap", help="Write the messages here.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.0, help="For how long; until Ctrl-C otherwise.")] = None,
    network: Annotated[bool, typer.Option(help="The robot may run on another machine.")] = False,
) -> None:
    """Log orientation, rate and specific force of the inertial unit from /imu/data; Ctrl-C completes the files."""
    if csv is None and mcap is None:
        raise typer.BadParameter("name a file: --csv FILE, --mcap FILE, or both")
    need_ros()
    from bridge.imu_log import CsvImuLog, ImuLog, McapImuLog
    from bridge.ros.imu_listener import ImuListener
    from models.nodes import topics
    from models.nodes.imu import ImuSample
    from models.nodes.message_text import message_text
    from models.nodes.spin import Stop

    logs: list[ImuLog] = []

    def take(stamp: int, sample: ImuSample, data: bytes) -> None:
        for log in logs:
            log.add(stamp, sample, data)

    listener = ImuListener(take)
    stop = Stop()  # Ctrl-C no longer interrupts: the files are completed
    with told():
        try:
            if mcap is not None:
                logs.append(McapImuLog(mcap, f"/{topics.IMU_DATA}", message_text("sensor_msgs/msg/Imu")))
            if csv is not None:
                logs.append(CsvImuLog(csv))
            listener.listen(seconds, stop, network=network)
        finally:
            for log in logs:
                if listener.count:
                    log.close()
                else:
                    log.discard()
    if not listener.count:
        raise typer.Exit(1)
    files = ", ".join(str(path) for path in (csv, mcap) if path is not None)
    refused = f", {listener.refused} refused" if listener.refused else ""
    Console().print(f"{listener.count} samples in {listener.duration:.3f} s{refused}: {files}", highlight=False)
