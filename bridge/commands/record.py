"""``poise record``, ``replay``, ``plot``, ``export`` and ``log``: record runs, replay, plot and export them."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.commands.common import Namespace, Network, console, need, need_ros, say

if TYPE_CHECKING:
    from bridge.replay.replay import ReplayReport

File = Annotated[Path, typer.Argument(help="Recording: the MCAP file of poise record or of a ClosedLoop.")]
Robot = Annotated[str, typer.Option(help="Robot profile, by name or path; by default that in the file.")]


def record(
    out: Annotated[Path | None, typer.Option(help="MCAP file; out/recording-TIME.mcap by default.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.0, help=r"Duration \[s]; by default until Ctrl-C.")] = None,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Record the topics of the running robot. Begin before `poise up`, so that `poise replay` can reproduce them."""
    need_ros()
    from bridge.record.graph_recorder import GraphRecorder
    from bridge.record.mcap_log import McapLog
    from models.nodes.spin import Stop

    path = out or Path("out") / f"recording-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap"
    stop = Stop()  # Ctrl-C no longer interrupts: the file is completed
    log = McapLog(path)
    recorder = GraphRecorder(log)
    try:
        recorder.record(seconds, stop, network=network, namespace=namespace, say=say)
    finally:
        log.close(keep=recorder.received > 0)
    if not recorder.received:
        say("nothing was recorded: no message of a robot was received")
        raise typer.Exit(1)
    from rich.table import Table

    table = Table("topic", "messages")
    for topic, count in sorted(log.counts.items()):
        table.add_row(topic, str(count))
    console().print(table)
    for topic, reason in recorder.left_out.items():
        say(f"{topic} left out: {reason}")
    lost = f"{recorder.lost} joint samples lost" if recorder.lost else "no joint sample lost"
    lost = lost if recorder.sampled else "no joint samples"
    say(f"{path}: {recorder.duration:.3f} s, {sum(log.counts.values())} messages, {lost}")
    raise typer.Exit(0 if recorder.sampled else 1)


def replay(
    file: Annotated[Path, typer.Argument(help="Recording (MCAP) or file of a black box (npz).")],
    robot: Robot = "",
) -> None:
    """Run the laws again on a recording or a black box; status 0 only if every command is the same to the last bit."""
    report = _replay(file, robot)
    for line in _lines(report):
        say(line)
    raise typer.Exit(0 if report.identical else 1)


def _replay(file: Path, robot: str) -> ReplayReport:
    from controllers.recording.black_box_file import SUFFIX, BlackBoxRecord

    if file.suffix == SUFFIX:
        from bridge.replay.replay import replay_box

        return replay_box(BlackBoxRecord.load(file), robot)
    need_ros()
    from bridge.record.run_file import read_run
    from bridge.replay.replay import replay as run_again

    return run_again(read_run(file, robot))


def _lines(report: ReplayReport) -> list[str]:
    since = "" if report.since is None else f", from t={report.since:.3f} s on"
    if report.identical:
        return [f"identical: {report.compared} commands of {report.ticks} ticks, to the last bit{since}"]
    lines = [f"not identical: {report.different} of {report.compared} commands differ{since}"]
    if report.first is not None:
        q, v, tau = report.largest
        lines.append(f"first difference at {report.first}")
        lines.append(f"largest: {q:.2g} rad, {v:.2g} rad/s, {tau:.2g} N.m")
    counts = {
        "ticks whose sensors are not all in the recording": report.lost,
        "records of the laws' inputs are missing": report.gaps,
        "commands of the replay are not in the recording": report.unrecorded,
        "recorded commands were not reproduced": report.unmatched,
    }
    lines += [f"{count} {what}" for what, count in counts.items() if count]
    return [*lines, *([f"ended at {report.end}"] if report.end else [])]


def plot(
    file: File,
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("out/plots"),
    robot: Robot = "",
) -> None:
    """Draw a recording: CoM, DCM and ZMP, torques, footsteps, modes and timing."""
    need_ros()
    from bridge.analysis.plots import plot_record
    from bridge.record.run_file import read_run

    files = plot_record(read_run(file, robot), out)
    say(", ".join(str(each) for each in files))


def export(
    files: Annotated[list[Path], typer.Argument(help="Recordings of one robot.")],
    out: Annotated[Path, typer.Option(help="Folder of the data set; a new or an empty one.")],
    fps: Annotated[int, typer.Option(min=1, max=1000, help="Frames per second.")] = 50,
    task: Annotated[str, typer.Option(help="Task of a single episode; by default each command is an episode.")] = "",
    robot: Robot = "",
) -> None:
    """Write recordings as a LeRobot data set (v3.0): sensor data, commands, the task in words."""
    need_ros()
    need("pyarrow", "pip install 'poise[dataset]'")
    from bridge.record.lerobot import export as write

    lengths = write(files, out, fps, task, robot)
    from rich.table import Table

    table = Table("task", "episodes", "frames")
    for each in dict.fromkeys(name for name, _ in lengths):
        frames = [n for name, n in lengths if name == each]
        table.add_row(each, str(len(frames)), str(sum(frames)))
    console().print(table)


log_app = typer.Typer(no_args_is_help=True, help="Write logs of the running robot, and draw those of its black box.")


@log_app.command()
def imu(
    csv: Annotated[Path | None, typer.Option("--csv", help="CSV file to write.")] = None,
    mcap: Annotated[Path | None, typer.Option("--mcap", help="MCAP file to write.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.0, help=r"Duration \[s]; by default until Ctrl-C.")] = None,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Log orientation, rate and specific force of the IMU from /imu/data; Ctrl-C completes the files."""
    if csv is None and mcap is None:
        raise typer.BadParameter("name a file: --csv FILE, --mcap FILE, or both")
    need_ros()
    from bridge.record.graph_recorder import ImuListener
    from bridge.record.mcap_log import McapLog
    from models.nodes import topics
    from models.nodes.imu import CsvImuLog, ImuSample
    from models.nodes.spin import Stop

    topic = f"/{topics.IMU_DATA}"
    messages: McapLog | None = None
    lines: CsvImuLog | None = None

    def take(stamp: int, sample: ImuSample, data: bytes) -> None:
        if messages is not None:
            messages.add(topic, data, stamp)
        if lines is not None:
            lines.add(stamp, sample, data)

    listener = ImuListener(take)
    stop = Stop()  # Ctrl-C no longer interrupts: the files are completed
    try:
        if mcap is not None:
            messages = McapLog(mcap)
            messages.announce(topic, "sensor_msgs/msg/Imu")
        if csv is not None:
            lines = CsvImuLog(csv)
        listener.listen(seconds, stop, network=network, namespace=namespace)
    finally:
        for log in (messages, lines):
            if log is not None:
                log.close(keep=listener.count > 0)
    if not listener.count:
        raise typer.Exit(1)
    files = ", ".join(str(path) for path in (csv, mcap) if path is not None)
    refused = f", {listener.refused} refused" if listener.refused else ""
    say(f"{listener.count} samples in {listener.duration:.3f} s{refused}: {files}")


@log_app.command("black-box")
def black_box(
    file: Annotated[Path, typer.Argument(help="File of a black box, by default in ~/.local/state/poise/black_box.")],
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("out/black_box"),
    last: Annotated[float, typer.Option(min=0.0, help=r"Duration to draw, at the end of the file \[s].")] = 60.0,
    robot: Robot = "",
) -> None:
    """Draw the last seconds before a fault from a black box, and print why it was written."""
    from bridge.analysis.plots import plot_black_box
    from controllers.recording.black_box_file import BlackBoxRecord
    from models.robot_model import RobotModel

    record = BlackBoxRecord.load(file).last(last)
    files = plot_black_box(RobotModel.load(robot or record.robot), record, out)
    say(f"{record.robot}, {len(record.t)} rows, {record.t[-1] - record.t[0]:.3f} s: {record.reason}")
    for t, text in record.events:
        say(f"{t:10.3f} s  {text}")
    say(", ".join(str(path) for path in files))
