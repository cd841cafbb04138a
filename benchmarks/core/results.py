"""File of finished cases: one JSON line per case, written when the case ends; no case is written twice.

A line is ``{"key", "bench", "robot", "seed", "scenario", "config", "revision", "versions", "machine", "load",
"seconds", "cpu_seconds", "case"}``. ``case`` holds inputs and outcome. The key is a hash of bench, configuration,
revision, versions and inputs, and of the machine for a timed case.
"""

import fcntl
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO

import numpy as np

from benchmarks.core.executors import Done
from benchmarks.core.provenance import digest
from models.errors import ConfigError

#: Names in JSON lines for numbers that JSON cannot represent
NONFINITE = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def plain(value: Any) -> Any:
    """Convert a value to dictionaries, lists, strings and Python numbers."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return value


def with_null(value: Any) -> Any:
    """Replace NaN and infinities by null; ``with_nan`` cannot distinguish them from other nulls."""
    return _each(value, lambda entry: None if _nonfinite(entry) else entry)


def with_nan(value: Any) -> Any:
    """Replace every null by NaN."""
    return _each(value, lambda entry: math.nan if entry is None else entry)


def encode_nonfinite(value: Any) -> Any:
    """Replace NaN and infinities by the names of ``NONFINITE``; inverse of ``decode_nonfinite``."""
    return _each(value, lambda entry: _name(entry) if _nonfinite(entry) else entry)


def decode_nonfinite(value: Any) -> Any:
    """Replace the names of ``NONFINITE`` by NaN and infinities."""
    return _each(value, lambda entry: NONFINITE.get(entry, entry) if isinstance(entry, str) else entry)


def _nonfinite(value: Any) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


def _name(value: float) -> str:
    return "NaN" if math.isnan(value) else "Infinity" if value > 0.0 else "-Infinity"


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    """Apply ``change`` to every entry that is neither a dictionary nor a list."""
    if isinstance(value, dict):
        return {key: _each(entry, change) for key, entry in value.items()}
    if isinstance(value, list):
        return [_each(entry, change) for entry in value]
    return change(value)


Line = dict[str, Any]

#: Marks a case that could not be measured on this machine: it is reported, but not stored, and the next run retries it
NOT_RUN = "not_run"


def case_key(bench: str, config: str, revision: str, environment: Mapping[str, str], inputs: Mapping[str, Any]) -> str:
    """Hash bench, ``provenance.configuration``, ``source_state``, packages and machine, and inputs with seed."""
    parts = [bench, config, revision, dict(environment), encode_nonfinite(plain(dict(inputs)))]
    return digest(json.dumps(parts, sort_keys=True).encode())


def scenario_of(inputs: Mapping[str, Any]) -> str:
    """Return the scenario of a case, or its inputs other than robot and seed as text."""
    if "scenario" in inputs:
        return str(inputs["scenario"])
    parts = {name: value for name, value in inputs.items() if name not in ("robot", "seed") and value != ""}
    return ", ".join(f"{name} {value}" for name, value in parts.items())


def line_of(
    key: str, bench: str, robot: str, config: str, inputs: Mapping[str, Any], case: Mapping[str, Any], done: Done
) -> Line:
    """Return the JSON line of a finished case."""
    given = {"key": key, "bench": bench, "robot": robot, "seed": inputs.get("seed"), "scenario": scenario_of(inputs)}
    names = ("revision", "versions", "machine", "load", "seconds", "cpu_seconds")
    where = {name: getattr(done, name) for name in names}
    return {**given, "config": config, **where, "case": case}


def read_lines(path: Path) -> list[Line]:
    """Read all complete JSON lines of a file; empty without a file; ``ConfigError`` for a damaged line."""
    if not path.is_file():
        return []
    *whole, _ = path.read_bytes().split(b"\n")  # a last line without newline was not completely written
    return [_parsed(text, f"{path}, line {number}") for number, text in enumerate(whole, start=1) if text]


def _parsed(text: bytes, where: str) -> Line:
    try:
        found = decode_nonfinite(json.loads(text))
    except ValueError as error:
        raise ConfigError(f"{where}: not JSON: {error}") from error
    if not isinstance(found, dict):
        raise ConfigError(f"{where}: not a JSON object")
    return found


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Convert ``OSError`` to ``ConfigError`` when a file or folder cannot be written."""
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from error


def check_folder(path: Path) -> None:
    """Create a folder; ``ConfigError`` if files cannot be written into it."""
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=path).close()


def check_file(path: Path) -> None:
    """Create the folder of a file; ``ConfigError`` if the file cannot be written."""
    check_folder(path.parent)
    with writing(path):
        if path.exists():
            path.open("ab").close()


def append_line(path: Path, line: Line) -> None:
    """Append a JSON line; an incomplete last line is removed first."""
    with path.open("a+b") as file:
        _truncate_incomplete_line(file)
        file.write(line_text(line).encode())


def _truncate_incomplete_line(file: BinaryIO) -> None:
    file.seek(0)
    file.truncate(file.read().rfind(b"\n") + 1)


def line_text(line: Line) -> str:
    """Return the JSON text of a line, with newline."""
    return json.dumps(encode_nonfinite(plain(line)), allow_nan=False) + "\n"


class ResultsFile(AbstractContextManager["ResultsFile"]):
    """Finished cases by key; locks the file while open and removes an incomplete last line.

    ``ConfigError`` if it cannot be written, is damaged, or is locked by another sweep.
    """

    def __init__(self, path: Path) -> None:
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise ConfigError(f"{path}: in use by another sweep; wait for its end, or name another file") from error
        try:
            lines = read_lines(path)
        except ConfigError:
            self._file.close()
            raise
        self._lines = {line["key"]: line for line in lines if "key" in line and not line["case"].get(NOT_RUN)}
        _truncate_incomplete_line(self._file)
        self.found = self.added = 0  #: Requested cases found in the file, and cases written
        self.requested: dict[str, list[str]] = {}  #: Keys of the cases requested by each benchmark, in order

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def case(self, key: str) -> Line | None:
        """Return inputs and outcome of a finished case; None if it is not finished."""
        line = self._lines.get(key)
        if line is None:
            return None
        self.found += 1
        return dict(line["case"])

    def has(self, keys: Iterable[str]) -> bool:
        """Whether all these cases are finished."""
        return all(key in self._lines for key in keys)

    def add(self, line: Line) -> None:
        """Write a finished case, unless the file has it."""
        if line["key"] in self._lines:
            return
        self._lines[line["key"]] = line
        self._file.write(line_text(line).encode())
        self._file.flush()
        self.added += 1
