"""Cuts a recording into episodes for learning: observations, actions, and the task as text."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bridge.record.mcap_log import EVENTS
from bridge.record.run_file import RecordedRun
from controllers.safety.health import SupervisorConfig
from controllers.safety.supervisor import ACTIVE_MODES, GAIT_WORDS
from models.config import default_config
from models.constants import FOOT_NAMES, NANOSECONDS
from models.nodes import topics
from models.robot_model import RobotModel
from models.types import Matrix, Mode, Vector

STALE = 0.05  #: Maximum age of a sample in a frame [s]; an older sample ends the episode
Frames = NDArray[np.float32]

_Table = tuple[NDArray[np.int64], Matrix]  #: Stamps [ns] and a row for each
_COMMANDS = "commands"
_STOP = "stop"


@dataclass(frozen=True, slots=True)
class Quantity:
    """Names and units of the columns of a feature."""

    names: tuple[str, ...]
    units: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Episode:
    """A part of a recording with one task."""

    task: str  #: The task as text
    start: int  #: Stamp of the first frame [ns]
    state: Frames  #: Measured and estimated quantities, columns as ``observed`` names them (n, s)
    action: Frames  #: Commands of the drivers at the same ticks, columns as ``commanded`` names them (n, a)


def observed(robot: RobotModel) -> Quantity:
    """Columns of an observation, in the frames of the sensors and ``base_link``, without x and y, which drift."""
    columns = _joint_columns(robot)
    columns += [("base.z", "m"), *((f"base.q{axis}", "1") for axis in "xyzw")]
    for kind, unit in (("base.v", "m/s"), ("base.w", "rad/s"), ("imu.gyro_", "rad/s"), ("imu.accel_", "m/s^2")):
        columns += [(f"{kind}{axis}", unit) for axis in "xyz"]
    if robot.profile.sensors.feet.fitted:
        for foot in FOOT_NAMES:
            columns += [(f"{foot}_foot.f{axis}", "N") for axis in "xyz"]
            columns += [(f"{foot}_foot.m{axis}", "N.m") for axis in "xyz"]
    return _quantity(columns)


def commanded(robot: RobotModel) -> Quantity:
    """Columns of an action: the driver commands without the gains."""
    return _quantity(_joint_columns(robot))


def _joint_columns(robot: RobotModel) -> list[tuple[str, str]]:
    kinds = (("pos", "rad"), ("vel", "rad/s"), ("torque", "N.m"))
    return [(f"{joint}.{kind}", unit) for kind, unit in kinds for joint in robot.joint_names]


def _quantity(columns: list[tuple[str, str]]) -> Quantity:
    names, units = zip(*columns, strict=True)
    return Quantity(names, units)


def episodes(run: RecordedRun, fps: int, task: str = "") -> Iterator[Episode]:
    """Cut a recording into episodes of at least two frames, in order, at ``fps`` frames per second.

    A frame has the newest sample of every sensor and the newest command at its time. It contains no later value and no
    true state of the simulator. Frames are evenly spaced within an episode. ``task`` is one task for all frames; when
    empty, each command is the task of an episode.
    """
    tables = _tables(run)
    if any(not len(stamps) for stamps, _ in tables.values()):
        return
    end = min(int(stamps[-1]) for stamps, _ in tables.values()) + 1
    cuts = _tasks(run)
    if task:  # from the first activity to its end; a new command is no cut
        cuts = [(stamp, task if name else None) for stamp, name in cuts]
        cuts = [cut for last, cut in zip([(0, None), *cuts], cuts, strict=False) if cut[1] != last[1]]
    for (first, name), (last, _) in zip(cuts, [*cuts[1:], (end, None)], strict=True):
        if name is not None:
            yield from _stretches(tables, first, min(last, end), fps, name)


def _stretches(tables: Mapping[str, _Table], first: int, end: int, fps: int, task: str) -> Iterator[Episode]:
    """Episodes between two stamps [ns]: one, or several if samples are missing."""
    times = first + np.rint(np.arange(max(end - first, 0) * fps // NANOSECONDS + 1) * (NANOSECONDS / fps)).astype(int)
    times = times[times < end]
    rows: dict[str, NDArray[np.int64]] = {}
    fresh = np.ones(len(times), dtype=bool)
    for name, (stamps, _) in tables.items():
        rows[name] = newest = np.searchsorted(stamps, times, side="right") - 1
        fresh &= (newest >= 0) & (times - stamps[newest] <= STALE * NANOSECONDS)
    edges = np.flatnonzero(np.diff(np.r_[False, fresh, False]))
    for begin, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - begin < 2:
            continue
        taken = {name: values[rows[name][begin:stop]] for name, (_, values) in tables.items()}
        action = taken.pop(_COMMANDS).astype(np.float32)
        state = np.hstack(list(taken.values())).astype(np.float32)
        yield Episode(task, int(times[begin]), state, action)


def _tables(run: RecordedRun) -> dict[str, _Table]:
    feet = run.feet if run.robot.profile.sensors.feet.fitted else ()
    return {
        "joints": _table({stamp: np.concatenate(values) for stamp, (_, *values) in run.joints.items()}),
        "base": _table({stamp: np.r_[pose[2:], twist] for stamp, (pose, twist) in run.estimates.items()}),
        "imu": _table({stamp: np.concatenate(values) for stamp, values in run.imu.items()}),
        **{name: _table(foot) for name, foot in zip(FOOT_NAMES, feet, strict=False)},
        _COMMANDS: _table({stamp: np.concatenate([c.q, c.v, c.tau]) for stamp, c in run.commands.items()}),
    }


def _table(samples: Mapping[int, Vector]) -> _Table:
    """Sorted stamps [ns] and one row for each, without rows that are not finite."""
    stamps = np.array(sorted(samples), dtype=np.int64)
    values = np.array([samples[int(stamp)] for stamp in stamps])
    good = np.isfinite(values).all(axis=1) if len(stamps) else np.zeros(0, dtype=bool)
    return stamps[good], values[good]


def _tasks(run: RecordedRun) -> list[tuple[int, str | None]]:
    """First stamp [ns] of each task; None for no task."""
    config = default_config(SupervisorConfig, "controllers", "supervisor")
    while_walking = {*GAIT_WORDS, *config.walking_motions, _STOP}
    known = {*while_walking, *config.motions, Mode.STAND.value}
    active = {mode.value for mode in ACTIVE_MODES}
    mode = word = ""
    cuts: list[tuple[int, str | None]] = []
    for stamp, topic, text in sorted(run.texts, key=lambda each: each[0]):
        if topic == topics.MODE:
            mode = text
            task = mode if mode == Mode.STAND.value else word or mode
            cuts.append((stamp, task if mode in active else None))
            word = ""
        elif (new := _word(topic, text)) in known:
            word = new
            if mode == Mode.WALK.value and word in while_walking:
                cuts.append((stamp, word))
    return cuts


def _word(topic: str, text: str) -> str:
    """Command word of a recorded text; empty when the closed loop refused it."""
    if topic == EVENTS:
        word, _, reply = text.partition(":")
        return "" if "refused" in reply else word.lower()
    return text.split()[-1].lower() if text.split() else ""  # last word of a signed text
