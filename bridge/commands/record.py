"""``poise record``, ``replay``, ``plot`` and ``export``: a run in a file, run again, drawn, and as a data set."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bridge.commands.common import Namespace, Network, console, need, need_ros, report_errors

if TYPE_CHECKING:
    from bridge.replay.replay import ReplayReport

File = Annotated[Path, typer.Argument(help="Recording: the MCAP file of poise record or of a ClosedLoop.")]
Robot = Annotated[str, typer.Option(help="Robot profile, by name or path; the one it names by default.")]


def record(
    out: Annotated[Path | None, typer.Option(help="MCAP file; out/recording-TIME.mcap otherwise.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.0, help="For how long; until Ctrl-C otherwise.")] = None,
    network: Network = False,
    namespace: Namespace = "",
) -> None:
    """Record the topics of the running robot. Begin before `poise up`, so that `poise replay` can reproduce them."""
    need_ros()
    from bridge.record.graph_recorder import GraphRecorder
    from bridge.record.mcap_log import McapLog
    from models.nodes.spin import Stop

    path = out or Path("out") / f"recording-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap"
    say = console(soft_wrap=True).print
    stop = Stop()  # Ctrl-C no longer interrupts: the file is completed
    with report_errors():
        log = McapLog(path)
        recorder = GraphRecorder(log)
        try:
            recorder.record(
                seconds, stop, network=network, namespace=namespace, say=lambda text: say(text, markup=False)
            )
        finally:
            if recorder.received:
                log.close()
            else:
                log.discard()
    if not recorder.received:
        say("nothing was recorded: no message of a robot arrived")
        raise typer.Exit(1)
    from rich.table import Table

    table = Table("topic", "messages")
    for topic, count in sorted(log.counts.items()):
        table.add_row(topic, str(count))
    console().print(table)
    for topic, reason in recorder.left_out.items():
        say(f"{topic} left out: {reason}", markup=False, highlight=False)
    lost = f"{recorder.lost} joint samples lost" if recorder.lost else "no joint sample lost"
    say(
        f"{path}: {recorder.duration:.3f} s, {sum(log.counts.values())} messages, {lost}", markup=False, highlight=False
    )


def replay(
    file: Annotated[Path, typer.Argument(help="Recording (MCAP) or file of a black box (npz).")],
    robot: Robot = "",
) -> None:
    """Run the laws again on a recording or a black box; status 0 only if every command is the same to the last bit."""
    with report_errors():
        report = _replay(file, robot)
    say = console(soft_wrap=True).print
    for line in _lines(report):
        say(line, markup=False, highlight=False)
    raise typer.Exit(0 if report.identical else 1)


def _replay(file: Path, robot: str) -> ReplayReport:
    """Replay of a black box, which needs no ROS 2, or of a recording."""
    from controllers.recording.black_box_file import SUFFIX, BlackBoxRecord

    if file.suffix == SUFFIX:
        from bridge.replay.replay import replay_box

        return replay_box(BlackBoxRecord.load(file), robot)
    need_ros()
    from bridge.record.run_file import read_run
    from bridge.replay.replay import replay as run_again

    return run_again(read_run(file, robot))


def _lines(report: ReplayReport) -> list[str]:
    """Lines that describe a replay."""
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
        "notes of the laws' inputs are missing": report.gaps,
        "commands of the replay are not in the recording": report.unrecorded,
        "recorded commands did not come about": report.unmatched,
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
    from bridge.plots.record import plot_record
    from bridge.record.run_file import read_run

    with report_errors():
        files = plot_record(read_run(file, robot), out)
    console(soft_wrap=True).print(", ".join(str(each) for each in files), markup=False, highlight=False)


def export(
    files: Annotated[list[Path], typer.Argument(help="Recordings of one robot.")],
    out: Annotated[Path, typer.Option(help="Folder of the data set; a new or an empty one.")],
    fps: Annotated[int, typer.Option(min=1, max=1000, help="Frames in a second.")] = 50,
    task: Annotated[str, typer.Option(help="Task of everything; otherwise an episode for each command.")] = "",
    robot: Robot = "",
) -> None:
    """Write recordings as a LeRobot data set (v3.0): sensor data, commands, the task in words."""
    need_ros()
    need("pyarrow", "dataset")
    from bridge.record.lerobot import export as write

    with report_errors():
        lengths = write(files, out, fps, task, robot)
    from rich.table import Table

    table = Table("task", "episodes", "frames")
    for each in dict.fromkeys(name for name, _ in lengths):
        frames = [n for name, n in lengths if name == each]
        table.add_row(each, str(len(frames)), str(sum(frames)))
    console().print(table)
