"""File of a black box, and the folder of the newest files."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from models.constants import NANOSECONDS
from models.errors import PoiseError
from models.files import open_arrays, state_folder
from models.law_state import Bytes
from models.types import Matrix, Mode, SolveStatus, Vector

FORMAT = 3  #: Version of the file
#: First version: single precision, no numbers of ticks, no state of the laws. This version and version 2, which has
#: another format of the state, can be read but not replayed.
SINGLE = 1
SUFFIX = ".npz"  #: Suffix of the files
#: Arrays of a file that can be replayed: inputs of the laws (JSON) and state of the laws
_INPUTS, _MEMORY = "replay", "replay_memory"
Array = NDArray[np.float32]

#: Arrays of the file and their units
UNITS = {
    "t": "s",
    "stamp": "ns",
    "number": "1",
    "sample_t": "s",
    "q": "m, quaternion xyzw, rad",
    "v": "m/s, rad/s, rad/s",
    "joint_q": "rad",
    "joint_v": "rad/s",
    "joint_tau": "N.m",
    "gyro": "rad/s",
    "accel": "m/s^2",
    "wrenches": "N, N.m",
    "command_q": "rad",
    "command_v": "rad/s",
    "command_tau": "N.m",
    "planned_wrenches": "N, N.m",
    "dcm": "m",
    "zmp": "m",
    "residual": "1",
    "status": "place in statuses",
    "mode": "place in modes",
}


@dataclass(frozen=True, slots=True)
class ReplayStart:
    """Start of a replay and the inputs of the stack after it."""

    record: dict[str, Any]  # settings, inputs, motions, and a description of the state
    data: Bytes  # arrays of the state


@dataclass(frozen=True, slots=True)
class BlackBoxRecord:
    """Content of a black box: n rows, oldest first; unknown values are NaN."""

    robot: str  # name of the profile
    reason: str  # cause of the record
    joint_names: tuple[str, ...]  # names of the joint columns
    events: tuple[tuple[float, str], ...]  # stamp [s] and text
    replay: ReplayStart | None  # start and inputs of a replay; None without one
    t: Vector  # stamps on the robot's clock (n,) [s]
    stamp: NDArray[np.int64]  # of the tick (n,) [ns]
    number: NDArray[np.int64]  # counter of ticks; rows are missing where it increases by more than 1 (n,)
    sample_t: Vector  # stamps of the sensor samples (n,) [s]
    q: Array  # estimated configuration in Pinocchio's order (n, nq)
    v: Array  # estimated velocity in Pinocchio's order (n, nv)
    joint_q: Matrix  # measured joint positions (n, nj)
    joint_v: Matrix  # measured joint velocities (n, nj)
    joint_tau: Matrix  # measured joint torques (n, nj)
    gyro: Matrix  # measured angular velocity in the IMU's frame (n, 3)
    accel: Matrix  # measured specific force in the IMU's frame (n, 3)
    wrenches: Matrix  # measured ground reaction on each foot in its sole frame (n, 2, 6)
    command_q: Matrix  # (n, nj)
    command_v: Matrix  # (n, nj)
    command_tau: Matrix  # (n, nj)
    planned_wrenches: Array  # contact wrenches of the QP's solution (n, 2, 6)
    dcm: Array  # measured, in the frame of the estimate (n, 2)
    zmp: Array  # commanded, in the frame of the estimate (n, 2)
    residual: Array  # largest KKT residual of the QP (n,)
    status: NDArray[np.int8]  # index in ``SolveStatus``; -1 without a command (n,)
    mode: NDArray[np.int8]  # index in ``Mode`` (n,)
    format: int = FORMAT  # version of the file from which it was read

    @property
    def modes(self) -> list[Mode]:
        """Mode of each row."""
        return [tuple(Mode)[int(i)] for i in self.mode]

    def last(self, duration: float) -> BlackBoxRecord:
        """Rows and events of the last ``duration`` [s], without the data for a replay."""
        begin = float(self.t.max(initial=-np.inf)) - duration
        rows = self.t >= begin
        arrays = {name: getattr(self, name)[rows] for name in UNITS}
        events = tuple(event for event in self.events if event[0] >= begin)
        return replace(self, events=events, replay=None, **arrays)

    def save(self, path: Path) -> None:
        """Write the record atomically. Raises ``PoiseError`` on failure, and leaves no partial file."""
        fresh = path.with_name(f".{path.name}.tmp")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                with fresh.open("wb") as stream:
                    arrays = {name: getattr(self, name) for name in UNITS}
                    if self.replay is not None:
                        arrays |= {_INPUTS: np.array(json.dumps(self.replay.record)), _MEMORY: self.replay.data}
                    np.savez(stream, meta=np.array(json.dumps(self._meta())), **arrays)
                    stream.flush()
                    os.fsync(stream.fileno())
                fresh.replace(path)
            finally:
                fresh.unlink(missing_ok=True)
        except OSError as error:
            raise PoiseError(f"{path}: black box not written: {error.strerror or error}") from error

    def _meta(self) -> dict[str, object]:
        return {
            "format": FORMAT,
            "robot": self.robot,
            "reason": self.reason,
            "written": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "joint_names": self.joint_names,
            "units": UNITS,
            "modes": [mode.value for mode in Mode],
            "statuses": [status.value for status in SolveStatus],
            "events": self.events,
        }

    @classmethod
    def load(cls, path: Path) -> BlackBoxRecord:
        """Read a file of ``save``; ``PoiseError`` when it is not a black box or has an unknown version."""
        try:
            with open_arrays(path) as data:
                meta = json.loads(str(data["meta"]))
                if meta["format"] not in range(SINGLE, FORMAT + 1):
                    raise PoiseError(f"{path}: black box of format {meta['format']}; this version reads {FORMAT}")
                arrays = {name: data[name] for name in UNITS if name in data or meta["format"] > SINGLE}
                if meta["format"] == SINGLE:
                    t = arrays["t"]
                    arrays["stamp"], arrays["number"] = np.round(t * NANOSECONDS).astype(np.int64), np.arange(len(t))
                    arrays["sample_t"] = np.full(len(t), np.nan)
                replay = (
                    ReplayStart(json.loads(str(data[_INPUTS])), data[_MEMORY])
                    if meta["format"] == FORMAT and _INPUTS in data
                    else None
                )
                return cls(
                    replay=replay,
                    robot=meta["robot"],
                    reason=meta["reason"],
                    joint_names=tuple(meta["joint_names"]),
                    events=tuple((float(t), str(text)) for t, text in meta["events"]),
                    format=meta["format"],
                    **arrays,
                )
        except (OSError, KeyError, ValueError, TypeError, EOFError, BadZipFile) as error:
            raise PoiseError(f"{path}: not the file of a black box: {error}") from error


class BlackBoxFolder:
    """Keeps the newest ``keep`` files of the robot ``name`` in ``folder``; empty for the user's state folder."""

    def __init__(self, name: str, folder: str | Path, keep: int) -> None:
        self._folder = Path(folder).expanduser() if str(folder) else state_folder("black_box")
        self._name, self._keep = name, keep

    def files(self) -> list[Path]:
        """Files of this robot, oldest first."""
        return sorted(self._folder.glob(f"{self._name}-*{SUFFIX}"))

    def save(self, record: BlackBoxRecord) -> Path:
        """Write a record to a file named by the current time and remove the oldest ones; ``PoiseError`` on failure."""
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%f")
        path = self._folder / f"{self._name}-{stamp}Z{SUFFIX}"
        record.save(path)
        others = [file for file in self.files() if file != path]  # keep the new file even if the clock was set back
        for file in others[: max(len(others) - self._keep + 1, 0)]:
            try:
                file.unlink(missing_ok=True)
            except OSError as error:
                raise PoiseError(f"{file}: old black box not removed: {error.strerror}") from error
        return path
