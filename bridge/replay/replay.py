"""Runs the laws on a recording or a black box and compares their commands, bit for bit."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bridge.replay.stack import ReplayedStack
from controllers.estimation.assembler import IMU, SOURCES
from controllers.input_log import TickInputs
from controllers.recording.black_box_file import FORMAT, BlackBoxRecord
from controllers.safety.supervisor import ACTIVE_MODES
from models.constants import FOOT_NAMES, NANOSECONDS
from models.errors import PoiseError
from models.robot_model import RobotModel
from models.types import JointCommand, JointTrajectory, SensorData, Vector

if TYPE_CHECKING:
    from bridge.record.run_file import RecordedRun


QUANTITIES = (("q", "rad"), ("v", "rad/s"), ("tau", "N.m"))  #: Quantities of a command, and their units


@dataclass(frozen=True, slots=True)
class Difference:
    """The first value of ``q``, ``v`` or ``tau`` in a command that differs, at a stamp [s]."""

    t: float
    joint: str
    quantity: str
    recorded: float
    replayed: float

    def __str__(self) -> str:
        unit = dict(QUANTITIES)[self.quantity]
        return (
            f"t={self.t:.3f} s, {self.joint}, {self.quantity}: {self.replayed!r} instead of {self.recorded!r} "
            f"({abs(self.replayed - self.recorded):.2g} {unit})"
        )


@dataclass(slots=True)
class ReplayReport:
    """Result of a replay."""

    ticks: int = 0  #: Samples given to the estimator
    compared: int = 0  #: Compared commands; all are identical when ``first`` is None
    different: int = 0  #: Commands that differ
    unrecorded: int = 0  #: Commands of the replay that are not in the recording
    unmatched: int = 0  #: Commands of the recording, since the start of the laws, that are not in the replay
    lost: int = 0  #: Ticks with missing sensors
    gaps: int = 0  #: Missing notes, from gaps in their numbers
    largest: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: Largest difference of each quantity [rad, rad/s, N.m]
    first: Difference | None = None  #: The first difference
    end: str = ""  #: Reason why the replay ended before the recording; empty when it did not
    since: float | None = None  #: Start of the replay at a checkpoint [s]; None without one

    @property
    def identical(self) -> bool:
        """Whether all commands are bit-identical, and none is missing in recording or replay."""
        wrong = self.different + self.unrecorded + self.unmatched + self.lost + self.gaps
        return self.compared > 0 and wrong == 0 and not self.end


def replay(run: RecordedRun) -> ReplayReport:
    """Run the laws from the first start of the estimator; ``PoiseError`` for a recording without start or sensors."""
    start = next((note for note in run.notes if note.value("start") is not None), None)
    if start is None:
        raise PoiseError(
            "the recording does not contain the start of the laws, which a replay needs: start the recording before "
            "the robot, or reset the robot while recording (service reset)"
        )
    laws = ReplayedStack(run.robot, start.value("start")["settings"], run.motions)
    report = ReplayReport(gaps=_gaps([note for note in run.notes if note.stamp >= start.stamp]))
    last_command = max(run.commands, default=0)
    given: set[int] = set()
    again = _repeated(run.notes)
    begun: int | None = None
    for stamp, sensors, note, dt in _ticks(run, start.stamp, report):
        if stamp > last_command:
            break  # the recording ended between the sensors and the command
        try:
            command = laws.tick(sensors, note, dt)
            for more in again.get(stamp, ()):
                command = laws.again(more) or command
        except PoiseError as error:
            report.end = f"t={stamp / NANOSECONDS:.3f} s: {error}"
            break
        report.ticks += 1
        begun = stamp if begun is None and laws.begun else begun
        if command is not None:
            given.add(stamp)
            compare(run.robot.joint_names, stamp, run.commands.get(stamp), command, report)
    report.unmatched = len([s for s in run.commands if begun is not None and s >= begun and s not in given])
    return report


def _repeated(notes: list[TickInputs]) -> dict[int, list[TickInputs]]:
    """Notes of repeated answers by stamp [ns]."""
    again = [note for note in notes if note.again]
    return {stamp: [note for note in again if note.stamp == stamp] for stamp in {note.stamp for note in again}}


def _gaps(notes: list[TickInputs]) -> int:
    numbers = {note.number for note in notes}
    return max(numbers) - min(numbers) + 1 - len(numbers)


def _ticks(
    run: RecordedRun, start: int, report: ReplayReport
) -> Iterator[tuple[int, SensorData, TickInputs | None, float | None]]:
    """Stamp, sample and note of every tick of the laws, and the length of the tick [s] if samples are missing.

    The notes give the time between ticks; the laws did not receive the samples in between. If the sample of a tick is
    missing, the tick is extended to the next sample.
    """
    notes = {note.stamp: note for note in run.notes if not note.again}
    before: dict[int, int] = {}  # stamp of a tick to that of the tick before, from the notes
    starts = {note.stamp: note.value("start")["after"] for note in run.notes if note.value("start") is not None}
    for note in run.notes:
        if (dt := note.value("dt")) is not None:
            before[note.stamp] = note.stamp - round(dt * NANOSECONDS)
    stamps = sorted(stamp for stamp in run.joints if stamp >= start)
    skipped: set[int] = set()
    for stamp, last in [*starts.items(), *before.items()]:
        skipped.update(stamps[bisect_right(stamps, last) : bisect_left(stamps, stamp)])
    period = last = 0
    for stamp in stamps:
        inputs = notes.get(stamp)
        if stamp in before:
            period = stamp - before[stamp]
        due = last + period
        if stamp in skipped or (last and stamp < due and inputs is None):
            continue
        sensors = _sample(run, stamp, inputs)
        if sensors is None:
            continue  # the next tick detects the missing one
        late = bool(last) and stamp != due and stamp not in starts
        if late:
            report.lost += 1
        yield stamp, sensors, inputs, (stamp - last) / NANOSECONDS if late else None
        last = stamp


def _sample(run: RecordedRun, stamp: int, note: TickInputs | None) -> SensorData | None:
    """Sensor data of a tick as the laws received them; None if a sample is missing."""
    mixed = (note.value("sample") if note is not None else None) or {}
    own, q, v, tau = run.joints[stamp]
    at = [mixed.get(source, stamp) for source in SOURCES[IMU:]]
    nothing: Vector = np.full(3, np.nan)
    imu = (nothing, nothing) if at[0] is None else run.imu.get(at[0])
    wrenches = np.full((len(FOOT_NAMES), 6), np.nan)
    for foot, kept in enumerate(run.feet):
        if not run.robot.profile.sensors.feet.fitted or at[1 + foot] is None:
            continue
        wrench = kept.get(at[1 + foot])
        if wrench is None:
            return None
        wrenches[foot] = wrench
    return None if imu is None else SensorData(own * 1e-9, q, v, tau, *imu, wrenches)


def compare(
    joints: Sequence[str], stamp: int, recorded: JointCommand | None, command: JointCommand, report: ReplayReport
) -> None:
    """Compare a command with the recorded one (None if there is none) at a stamp [ns]; count it in ``report``."""
    if recorded is None:
        report.unrecorded += 1
        return
    report.compared += 1
    largest = list(report.largest)
    first: Difference | None = None
    for i, (quantity, _) in enumerate(QUANTITIES):
        old, new = getattr(recorded, quantity), getattr(command, quantity)
        wrong = old.view(np.int64) != np.ascontiguousarray(new).view(np.int64)  # bitwise: -0.0 differs from 0.0
        if not wrong.any():
            continue
        largest[i] = max(largest[i], float(np.abs(new - old).max()))
        j = int(np.flatnonzero(wrong)[0])
        first = first or Difference(stamp / NANOSECONDS, joints[j], quantity, float(old[j]), float(new[j]))
    if first is not None:
        report.different += 1
        report.largest = (largest[0], largest[1], largest[2])
        report.first = report.first or first


def replay_box(record: BlackBoxRecord, robot: str = "") -> ReplayReport:
    """Run the laws of a black box.

    A damped row has no command; the answer of a law to such a tick is not compared. ``robot`` is a profile, by name or
    path; when empty, the profile of the record. Raises ``PoiseError`` without a checkpoint or for another version,
    ``ConfigError`` for settings of another version.
    """
    if record.format < FORMAT:
        raise PoiseError(
            f"the black box was written by an earlier version (format {record.format}) without an initial state of "
            "the laws for this version: it can be drawn (poise log black-box), but not replayed"
        )
    if record.replay is None:
        raise PoiseError(
            "the black box contains no initial state of the laws: no law had moved the joints, rows are missing "
            "(black_box.period is longer than a tick), or estimator and controller ran in different processes"
        )
    start = record.replay.record
    model = RobotModel.load(robot or record.robot)
    motions = {int(number): _motion(each) for number, each in start["motions"].items()}
    laws = ReplayedStack(model, start["settings"], motions)
    laws.restore(record.replay)
    notes = [TickInputs.read(text) for text in start["inputs"]]
    first = {note.stamp: note for note in notes if not note.again}
    again = _repeated(notes)
    report = ReplayReport(since=start["stamp"] / NANOSECONDS)
    for more in again.get(start["stamp"], ()):
        laws.again(more)
    last, modes = int(start["row"]), record.modes
    for row in np.flatnonzero(record.number > start["row"]):
        report.lost += int(record.number[row]) != last + 1
        last = int(record.number[row])
        stamp = int(record.stamp[row])
        try:
            command = laws.tick(_row_sample(record, row), first.get(stamp))
            for more in again.get(stamp, ()):  # the row contains the first answer
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


def _row_sample(record: BlackBoxRecord, row: int) -> SensorData:
    return SensorData(
        float(record.sample_t[row]), record.joint_q[row], record.joint_v[row], record.joint_tau[row],
        record.gyro[row], record.accel[row], record.wrenches[row],
    )  # fmt: skip


def _command(record: BlackBoxRecord, row: int) -> JointCommand | None:
    if record.status[row] < 0:
        return None
    return JointCommand(record.command_q[row], record.command_v[row], record.command_tau[row])


def _motion(start: dict[str, Any]) -> JointTrajectory:
    names = ("times", "positions", "velocities", "efforts")
    rows: list[Any] = [None if start[name] is None else np.array(start[name], dtype=float) for name in names]
    return JointTrajectory(tuple(start["joint_names"]), *rows)
