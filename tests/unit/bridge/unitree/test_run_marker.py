"""The mark of an unfinished run: of a driver that is alive, of one that was killed, and its end."""

import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from bridge.plants.hardware import RunMarker
from models.errors import ConfigError

DRIVER = """
import sys
from pathlib import Path
from bridge.plants.hardware import RunMarker
marker = RunMarker(Path(sys.argv[1]))
marker.make()
print("made", flush=True)
sys.stdin.read()
"""


def test_a_mark_of_a_driver_that_is_alive_refuses_another_and_outlives_it(root: Path, tmp_path: Path) -> None:
    file = tmp_path / "state" / "lo-1"
    before = RunMarker(file)  # before the other one has commanded the robot
    command = [sys.executable, "-c", DRIVER, str(file)]
    with subprocess.Popen(command, cwd=root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None and driver.stdout.readline() == "made\n"
        with pytest.raises(ConfigError, match=f"process {driver.pid} is the driver of another 'poise up'"):
            RunMarker(file)
        before.make()
        before.remove()
        assert file.exists()
        driver.kill()
    after = RunMarker(file)
    assert after.crashed and not after.made
    after.make()
    after.remove()
    assert not file.exists() and not RunMarker(file).crashed


@contextmanager
def full_disk() -> Iterator[None]:
    """No file can grow."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_folder_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=f"{tmp_path}/file cannot be written"):
        RunMarker(tmp_path / "file" / "lo-1")
    with full_disk(), pytest.raises(ConfigError, match=f"{tmp_path} cannot be written"):
        RunMarker(tmp_path / "lo-1")


def test_a_disk_that_is_full_later_stops_neither_this_driver_nor_the_next(tmp_path: Path) -> None:
    marker = RunMarker(tmp_path / "lo-1")
    with full_disk():
        marker.make()
        assert marker.made and "the marker of this run is incomplete" in marker.failure
        del marker  # which unlocks it, as the end of its process does
        after = RunMarker(tmp_path / "lo-1")
        after.make()
        assert after.crashed and after.failure
        after.remove()
    assert not (tmp_path / "lo-1").exists() and not after.failure
