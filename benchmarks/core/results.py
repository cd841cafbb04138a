"""The file of finished cases: one JSON line each, written as soon as it is done, and never the same case twice.

A line is ``{"key", "bench", "robot", "seed", "scenario", "config", "revision", "versions", "machine", "load",
"seconds", "cpu_seconds", "case"}``: ``case`` holds inputs and outcome; the key is a hash of bench, configuration,
revision and inputs.
"""

import fcntl
import json
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from benchmarks.core.executors import Done
from benchmarks.core.provenance import digest
from models.errors import ConfigError

#: What stands in a JSON line for a number that JSON has no word for
WORDS = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def plain(value: Any) -> Any:
    """The value in dictionaries, lists, strings and Python's own numbers."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    return value


def nulled(value: Any) -> Any:
    """A plain value with null for what JSON has no word for; ``with_nan`` cannot distinguish it from another null."""
    return _each(value, lambda entry: None if _wordless(entry) else entry)


def with_nan(value: Any) -> Any:
    """A plain value with NaN for every null."""
    return _each(value, lambda entry: math.nan if entry is None else entry)


def worded(value: Any) -> Any:
    """A plain value with one of ``WORDS`` for what JSON has no word for; ``unworded`` takes it back."""
    return _each(value, lambda entry: _word(entry) if _wordless(entry) else entry)


def unworded(value: Any) -> Any:
    """What ``worded`` was given."""
    return _each(value, lambda entry: WORDS.get(entry, entry) if isinstance(entry, str) else entry)


def _wordless(value: Any) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


def _word(value: float) -> str:
    return "NaN" if math.isnan(value) else "Infinity" if value > 0.0 else "-Infinity"


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    """A plain value with every entry that holds no others changed."""
    if isinstance(value, dict):
        return {key: _each(entry, change) for key, entry in value.items()}
    if isinstance(value, list):
        return [_each(entry, change) for entry in value]
    return change(value)


Line = dict[str, Any]

#: Says of a case that it could not be measured here; it is reported but not kept, so that it is tried again
NOT_RUN = "not_run"


def case_key(bench: str, config: str, revision: str, inputs: Mapping[str, Any]) -> str:
    """Hash of bench, ``provenance.configuration``, ``provenance.source_state`` and inputs, with robot and seed."""
    return digest(json.dumps([bench, config, revision, worded(plain(dict(inputs)))], sort_keys=True).encode())


def scenario_of(inputs: Mapping[str, Any]) -> str:
    """What a case is besides its robot and seed, for who reads the file."""
    if "scenario" in inputs:
        return str(inputs["scenario"])
    parts = {name: value for name, value in inputs.items() if name not in ("robot", "seed") and value != ""}
    return ", ".join(f"{name} {value}" for name, value in parts.items())


def line_of(
    key: str, bench: str, robot: str, config: str, inputs: Mapping[str, Any], case: Mapping[str, Any], done: Done
) -> Line:
    """Entry of one finished case."""
    given = {"key": key, "bench": bench, "robot": robot, "seed": inputs.get("seed"), "scenario": scenario_of(inputs)}
    names = ("revision", "versions", "machine", "load", "seconds", "cpu_seconds")
    where = {name: getattr(done, name) for name in names}
    return {**given, "config": config, **where, "case": case}


def read_lines(path: Path) -> list[Line]:
    """Every whole line of a file of JSON lines; empty without a file; ``ConfigError`` names a damaged line."""
    if not path.is_file():
        return []
    *whole, _ = path.read_bytes().split(b"\n")  # what follows the last end of a line was cut off in writing
    return [_parsed(text, f"{path}, line {number}") for number, text in enumerate(whole, start=1) if text]


def _parsed(text: bytes, where: str) -> Line:
    try:
        found = unworded(json.loads(text))
    except ValueError as error:
        raise ConfigError(f"{where}: not JSON: {error}") from error
    if not isinstance(found, dict):
        raise ConfigError(f"{where}: not a JSON object")
    return found


def append_line(path: Path, line: Line) -> None:
    """Add one line to a file of JSON lines; what was cut off in writing before it is taken away."""
    with path.open("a+b") as file:
        _take_away_the_rest(file)
        file.write(line_text(line).encode())


def _take_away_the_rest(file: BinaryIO) -> None:
    file.seek(0)
    file.truncate(file.read().rfind(b"\n") + 1)


def line_text(line: Line) -> str:
    """JSON of a line, with its end."""
    return json.dumps(worded(plain(line)), allow_nan=False) + "\n"


class ResultsFile(AbstractContextManager["ResultsFile"]):
    """Finished cases by key; locks the file while open, else ``ConfigError``, and removes an incomplete last line."""

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise ConfigError(f"{path}: another sweep writes to it") from error
        try:
            lines = read_lines(path)
        except ConfigError:
            self._file.close()
            raise
        self._lines = {line["key"]: line for line in lines if "key" in line and not line["case"].get(NOT_RUN)}
        _take_away_the_rest(self._file)
        self.found = self.added = 0  #: Requested cases that were in the file, and cases written
        self.taken: dict[str, list[str]] = {}  #: Keys of the cases that each benchmark requested, in order

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def case(self, key: str) -> Line | None:
        """Inputs and outcome of a finished case; None when it is not finished."""
        line = self._lines.get(key)
        if line is None:
            return None
        self.found += 1
        return dict(line["case"])

    def has(self, keys: Iterable[str]) -> bool:
        """Whether all these cases are finished."""
        return all(key in self._lines for key in keys)

    def add(self, line: Line) -> None:
        """Write a finished case, unless it is there."""
        if line["key"] in self._lines:
            return
        self._lines[line["key"]] = line
        self._file.write(line_text(line).encode())
        self._file.flush()
        self.added += 1
