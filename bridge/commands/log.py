"""``poise log WHAT``: logs of a running robot, written on request, and its black box, drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bridge.commands.common import Namespace, Network, console, need_ros, report_errors

app = typer.Typer(no_args_is_help=True, help="Write logs of the running robot, and draw those of its black box.")


@app.command()
def imu(
    csv: Annotated[Path | None, typer.Option("--csv", help="Write a table here.")] = None,
    mcap: Annotated[Path | None, typer.Option("--mcap", help="Write the messages here.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.0, help="For how long; until Ctrl-C otherwise.")] = None,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Log orientation, rate and specific force of the IMU from /imu/data; Ctrl-C completes the files."""
    if csv is None and mcap is None:
        raise typer.BadParameter("name a file: --csv FILE, --mcap FILE, or both")
    need_ros()
    from bridge.record.graph_recorder import ImuListener
    from bridge.record.mcap_log import ImuLog, McapImuLog
    from models.nodes import topics
    from models.nodes.imu import CsvImuLog, ImuSample
    from models.nodes.spin import Stop

    logs: list[ImuLog] = []

    def take(stamp: int, sample: ImuSample, data: bytes) -> None:
        for log in logs:
            log.add(stamp, sample, data)

    listener = ImuListener(take)
    stop = Stop()  # Ctrl-C no longer interrupts: the files are completed
    with report_errors():
        try:
            if mcap is not None:
                logs.append(McapImuLog(mcap, f"/{topics.IMU_DATA}"))
            if csv is not None:
                logs.append(CsvImuLog(csv))
            listener.listen(seconds, stop, network=network, namespace=namespace)
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
    console().print(f"{listener.count} samples in {listener.duration:.3f} s{refused}: {files}", highlight=False)


@app.command("black-box")
def black_box(
    file: Annotated[Path, typer.Argument(help="File of a black box; ~/.local/state/poise/black_box holds them.")],
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("out/black_box"),
    last: Annotated[float, typer.Option(min=0.0, help="Draw so many seconds of its end.")] = 60.0,
    robot: Annotated[str, typer.Option(help="Robot profile, by name or path; the one it names by default.")] = "",
) -> None:
    """Draw what a black box holds of the last seconds before a fault, and say why it was written."""
    from bridge.plots.record import plot_black_box
    from controllers.recording.black_box_file import BlackBoxRecord
    from models.robot_model import RobotModel

    with report_errors():
        record = BlackBoxRecord.load(file).last(last)
        files = plot_black_box(RobotModel.load(robot or record.robot), record, out)
    say = console(soft_wrap=True).print
    say(f"{record.robot}, {len(record.t)} rows, {record.t[-1] - record.t[0]:.3f} s: {record.reason}", markup=False)
    for t, text in record.events:
        say(f"{t:10.3f} s  {text}", markup=False, highlight=False)
    say(", ".join(str(path) for path in files), markup=False, highlight=False)
