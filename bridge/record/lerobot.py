"""Writes episodes as a LeRobot dataset, version 3.0: Parquet tables of frames, and index tables.

    data/chunk-000/file-000.parquet            frames, one row group for each episode
    meta/info.json                             rate, totals, and type, shape, names and units of every feature
    meta/tasks.parquet                         tasks as text and their numbers
    meta/episodes/chunk-000/file-000.parquet   task, length, rows and statistics of every episode
    meta/stats.json                            statistics of all frames

Source: huggingface/lerobot, ``datasets/lerobot_dataset.py`` and ``datasets/utils.py``, ``CODEBASE_VERSION`` v3.0.
"""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bridge.record.episodes import Episode, Quantity, commanded, episodes, observed
from bridge.record.run_file import read_run
from models.errors import PoiseError

VERSION = "v3.0"  #: Version of the layout
#: Files in a folder [1] and approximate file sizes [MB]: the defaults of the layout
CHUNK_SIZE, DATA_FILE_MB, VIDEO_FILE_MB = 1000, 100, 200
STATE, ACTION = "observation.state", "action"
TASKS, INFO, STATS = "meta/tasks.parquet", "meta/info.json", "meta/stats.json"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

_NUMBERS = {"timestamp": "float32", **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64")}
_QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}

Columns = dict[str, NDArray[Any]]


class LeRobotDataset:
    """Collects episodes; ``close`` moves the complete data set to the new ``folder``. ``PoiseError`` if it is in use.

    ``lengths`` holds task and number of frames of every episode.
    """

    def __init__(self, folder: Path, robot: str, fps: int, state: Quantity, action: Quantity) -> None:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise PoiseError(f"{folder}: exists already and is not an empty folder; give an empty or a new one")
        self._folder, self._part = folder, folder.with_name(f".{folder.name}.part")
        self._robot, self._fps = robot, fps
        self._quantities = {STATE: state, ACTION: action}
        self._schema = pa.schema(
            [(name, pa.list_(pa.float32(), len(each.names))) for name, each in self._quantities.items()]
            + [(name, pa.type_for_alias(kind)) for name, kind in _NUMBERS.items()]
        )
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []
        self._all: list[Columns] = []
        self._file, self._bytes = 0, 0
        self._writer: pq.ParquetWriter | None = None
        self.frames = 0
        self.lengths: list[tuple[str, int]] = []
        with self._disk():
            shutil.rmtree(self._part, ignore_errors=True)  # left by a killed run
            (self._part / "meta").mkdir(parents=True)

    @contextmanager
    def _disk(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise PoiseError(f"{self._folder} cannot be written: {error}") from error

    def add(self, episode: Episode) -> None:
        """Write an episode; ``PoiseError`` when writing fails."""
        n, number = len(episode.state), len(self._rows)
        task = self._tasks.setdefault(episode.task, len(self._tasks))
        columns: Columns = {
            STATE: episode.state,
            ACTION: episode.action,
            "timestamp": (np.arange(n) / self._fps).astype(np.float32),
            "frame_index": np.arange(n),
            "episode_index": np.full(n, number),
            "index": np.arange(self.frames, self.frames + n),
            "task_index": np.full(n, task),
        }
        with self._disk():
            self._write_frames(columns)
        row: dict[str, Any] = {
            "episode_index": number,
            "tasks": [episode.task],
            "length": n,
            **_place("data", self._file),
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + n,
        }
        for feature, statistics in _statistics(columns).items():
            row |= {f"stats/{feature}/{name}": value for name, value in statistics.items()}
        self._rows.append(row | _place("meta/episodes", 0))
        self._all.append(columns)
        self.frames += n
        self.lengths.append((episode.task, n))

    def _write_frames(self, columns: Columns) -> None:
        arrays = [
            pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1]) if values.ndim == 2 else values
            for values in columns.values()
        ]
        table = pa.Table.from_arrays([pa.array(each) for each in arrays], schema=self._schema)
        if self._writer is not None and self._bytes + table.nbytes > DATA_FILE_MB * 2**20:
            self._writer.close()
            self._writer, self._file, self._bytes = None, self._file + 1, 0
        if self._writer is None:
            path = self._part / _path(DATA, self._file)
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, self._schema)
        self._writer.write_table(table, row_group_size=len(columns[STATE]))
        self._bytes += table.nbytes

    def close(self) -> None:
        """Write the metadata and move the folder to its path; ``PoiseError`` without episodes or when writing fails."""
        if self._writer is None:
            raise PoiseError(f"{self._folder}: no episode was found: the robot was not commanded while it was recorded")
        with self._disk():
            self._writer.close()
            path = self._part / _path(EPISODES, 0)
            path.parent.mkdir(parents=True)
            pq.write_table(pa.Table.from_pylist(self._rows), path)
            pq.write_table(_task_table(self._tasks), self._part / TASKS)
            every = {name: np.concatenate([each[name] for each in self._all]) for name in self._schema.names}
            _write_json(self._part / STATS, _statistics(every))
            _write_json(self._part / INFO, self._info())
            if self._folder.exists():
                self._folder.rmdir()
            self._part.rename(self._folder)

    def discard(self) -> None:
        """Delete the incomplete data set."""
        if self._writer is not None:
            self._writer.close()
        shutil.rmtree(self._part, ignore_errors=True)

    def _info(self) -> dict[str, Any]:
        vectors: dict[str, Any] = {
            name: {"dtype": "float32", "shape": [len(each.names)], "names": each.names, "units": each.units}
            for name, each in self._quantities.items()
        }
        numbers = {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in _NUMBERS.items()}
        return {
            "codebase_version": VERSION,
            "robot_type": self._robot,
            "total_episodes": len(self._rows),
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK_SIZE,
            "data_files_size_in_mb": DATA_FILE_MB,
            "video_files_size_in_mb": VIDEO_FILE_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": DATA,
            "video_path": None,
            "features": vectors | numbers,
        }


def _place(what: str, file: int) -> dict[str, int]:
    return {f"{what}/chunk_index": file // CHUNK_SIZE, f"{what}/file_index": file % CHUNK_SIZE}


def _path(pattern: str, file: int) -> str:
    return pattern.format(chunk_index=file // CHUNK_SIZE, file_index=file % CHUNK_SIZE)


def _statistics(columns: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, list[float] | list[int]]]:
    statistics: dict[str, dict[str, list[float] | list[int]]] = {}
    for feature, values in columns.items():
        table = values.reshape(len(values), -1).astype(float)  # (n, c)
        statistics[feature] = {
            "min": table.min(axis=0).tolist(),
            "max": table.max(axis=0).tolist(),
            "mean": table.mean(axis=0).tolist(),
            "std": table.std(axis=0).tolist(),
            "count": [len(table)],
            **{name: np.quantile(table, share, axis=0).tolist() for name, share in _QUANTILES.items()},
        }
    return statistics


def _task_table(tasks: Mapping[str, int]) -> pa.Table:
    """Table of tasks and numbers; its metadata makes the task the index for pandas, with which LeRobot reads it."""
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored, "metadata": None}
        for name, kind, stored in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    metadata = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    return pa.table({"task_index": list(tasks.values()), "task": list(tasks)}).replace_schema_metadata(
        {"pandas": json.dumps(metadata)}
    )


def _write_json(path: Path, data: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(data, indent=4, ensure_ascii=False), encoding="utf-8")


def export(files: Sequence[Path], folder: Path, fps: int, task: str = "", robot: str = "") -> list[tuple[str, int]]:
    """Write recordings of one robot as a data set; returns task and number of frames of every episode.

    ``task`` applies to all frames; when empty, each command makes an episode. ``robot`` is a profile, by name or path;
    when empty, the profile in the files. Raises ``PoiseError`` when a file is no recording or is of another robot,
    there is no episode, or the folder cannot be written.
    """
    runs = (read_run(file, robot) for file in files)
    first = next(runs)
    name = first.robot.name
    dataset = LeRobotDataset(folder, name, fps, observed(first.robot), commanded(first.robot))
    try:
        for file, run in zip(files, chain((first,), runs), strict=True):
            if run.robot.name != name:
                raise PoiseError(f"{file}: is of robot '{run.robot.name}', the files before it of '{name}'")
            for episode in episodes(run, fps, task):
                dataset.add(episode)
        dataset.close()
    except BaseException:
        dataset.discard()
        raise
    return dataset.lengths
