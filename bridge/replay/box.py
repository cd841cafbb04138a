"""Runs the laws on a black box, from its first checkpoint to its end."""

from __future__ import annotations

from typing import Any

import numpy as np

from bridge.replay.replay import ReplayReport, compare
from bridge.replay.stack import ReplayedStack
from controllers.input_log import TickInputs
from controllers.recording.black_box_file import FORMAT, BlackBoxRecord
from controllers.safety.supervisor import ACTIVE_MODES
from models.constants import NANOSECONDS
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory, SensorData


def replay_box(record: BlackBoxRecord, robot: str = "") -> ReplayReport:
    """Run the laws of a black box.

    A damped row has no command: where a law still answered that tick, its answer is not compared. ``robot`` is a
    profile, by name or path; that of the record when empty. Raises ``PoiseError`` without a checkpoint or for another
    version, ``ConfigError`` when the settings are not of this version.
    """
    if record.format < FORMAT:
        raise PoiseError(
            f"the black box was written by an earlier version (format {record.format}): it is of single precision and "
            "holds no state of the laws, so it can be looked at (poise log black-box), not run again"
        )
    if record.replay is None:
        raise PoiseError(
            "the black box holds no state of the laws to begin with: no law had moved the joints, rows are missing "
            "(black_box.period is longer than a tick), or estimator and controller ran in different processes"
        )
    start = record.replay.record
    model = RobotModel.load(robot or record.robot)
    motions = {int(number): _motion(each) for number, each in start["motions"].items()}
    laws = ReplayedStack(model, start["settings"], motions)
    laws.restore(record.replay)
    notes = [TickInputs.read(text) for text in start["inputs"]]
    first = {note.stamp: note for note in notes if not note.again}
    again: dict[int, list[TickInputs]] = {}
    for note in notes:
        if note.again:
            again.setdefault(note.stamp, []).append(note)
    report = ReplayReport(since=start["stamp"] / NANOSECONDS)
    for more in again.get(start["stamp"], ()):
        laws.again(more)
    last, modes = int(start["row"]), record.modes
    for row in np.flatnonzero(record.number > start["row"]):
        report.lost += int(record.number[row]) != last + 1
        last = int(record.number[row])
        stamp = int(record.stamp[row])
        try:
            command = laws.tick(_sample(record, row), first.get(stamp))
            for more in again.get(stamp, ()):  # the row holds the first answer
                laws.again(more)
        except PoiseError as error:
            report.end = f"t={stamp / NANOSECONDS:.3f} s: {error}"
            break
        report.ticks += 1
        recorded = _command(record, row)
        if command is not None and (recorded is not None or modes[row] in ACTIVE_MODES):
            compare(model.joint_names, stamp, recorded, command, report)
        elif command is None and recorded is not None:
            report.unmatched += 1
    return report


def _sample(record: BlackBoxRecord, row: int) -> SensorData:
    return SensorData(
        float(record.sample_t[row]), record.joint_q[row], record.joint_v[row], record.joint_tau[row],
        record.gyro[row], record.accel[row], record.wrenches[row],
    )  # fmt: skip


def _command(record: BlackBoxRecord, row: int) -> JointCommand | None:
    """The command of a row; None without one."""
    if record.status[row] < 0:
        return None
    return JointCommand(record.command_q[row], record.command_v[row], record.command_tau[row])


def _motion(start: dict[str, Any]) -> JointTrajectory:
    def numbers(name: str) -> Any:
        return None if start[name] is None else np.array(start[name], dtype=float)

    times, positions = np.array(start["times"], dtype=float), np.array(start["positions"], dtype=float)
    return JointTrajectory(tuple(start["joint_names"]), times, positions, numbers("velocities"), numbers("efforts"))
