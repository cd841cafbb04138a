"""Robot side in another process, called over pipes."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from benchmarks.core.cable import ERROR_MAX
from models.errors import PoiseError

LOOPBACK = Path(__file__).resolve().parents[2] / "bridge" / "config" / "loopback.xml"
UNITREE_SIDE = "benchmarks.graph.unitree_side"


class RobotProcess:
    """Process of a ``module`` such as ``benchmarks.graph.unitree_side``, called over pipes.

    ``command`` is an optional prefix that runs it on another machine.
    """

    def __init__(
        self,
        side: str,
        interface: str,
        folder: Path,
        *arguments: object,
        command: Sequence[str] = (),
        domain: int = 0,
        module: str = UNITREE_SIDE,
    ) -> None:
        environment: Mapping[str, str] = os.environ
        if interface == "lo":
            local = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(LOOPBACK), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}
            environment = {**os.environ, **local}
        self._log = folder / "robot.log"
        self._errors = self._log.open("wb")
        program = [sys.executable, "-m", module, side, interface, str(domain), *map(str, arguments)]
        self._process = subprocess.Popen(
            [*command, *program], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors,
            text=True,
        )  # fmt: skip

    def __call__(self, name: str, *arguments: object) -> Any:
        """Call a method of ``Program`` and return its result; ``PoiseError`` when the process has ended."""
        assert self._process.stdin is not None and self._process.stdout is not None
        line = ""
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps([name, *arguments]) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        if line:
            return json.loads(line)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5.0)
        errors = self._log.read_text(encoding="utf-8", errors="replace")[-ERROR_MAX:].strip()
        code = self._process.returncode
        raise PoiseError(
            f"the process of the robot ended during '{name}': exit code {code}; {self._log.name}: {errors}"
        )

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._errors):
            if pipe is not None:
                with suppress(BrokenPipeError):  # data that an ended process has not read
                    pipe.close()
