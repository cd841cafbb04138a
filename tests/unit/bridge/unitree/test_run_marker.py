"""The mark of an unfinished run: of a driver that is alive, of one that was killed, and its end."""

import subprocess
import sys
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
