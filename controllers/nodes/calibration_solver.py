"""Works out a calibration in a process of its own: the closed chain takes seconds, and a tick has one millisecond."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

from controllers.calibration.outcome import Outcome, refuse
from controllers.calibration.session import CalibrationJob, solve
from models.errors import PoiseError
from models.nodes.realtime import die_with_parent
from models.robot_model import RobotModel

NICENESS = 10
"""The solver yields to whoever else wants the processor."""

JOB, OUTCOME = "job", "outcome"
"""Files by which the two processes speak; a pipe would block the one that has a tick to keep."""


class CalibrationSolver:
    """Runs ``solve`` elsewhere and hands the outcome over when asked.

    Args:
        robot: Profile of the robot, by name or path.
    """

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def start(self, job: CalibrationJob) -> None:
        """Begin to work out a calibration; one at a time."""
        self.close()
        self._folder = tempfile.TemporaryDirectory(prefix="poise_solver_")
        (Path(self._folder.name) / JOB).write_bytes(pickle.dumps((self._robot, job)))
        self._process = subprocess.Popen([sys.executable, "-m", __spec__.name, self._folder.name])

    def poll(self) -> Outcome | None:
        """The outcome, once; None while it is being worked out, or when nothing is."""
        if self._process is None or self._folder is None or self._process.poll() is None:
            return None
        try:
            outcome: Outcome = pickle.loads((Path(self._folder.name) / OUTCOME).read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            outcome = refuse(f"the calculation ended with code {self._process.returncode}", {})
        self.close()
        return outcome

    def close(self) -> None:
        """End the process, whatever it is at."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._folder is not None:
            self._folder.cleanup()
        self._process = self._folder = None


def main(folder: Path) -> None:
    """Body of the process: neither the real-time priority of the control loop, nor its cores, are for this."""
    die_with_parent()
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setaffinity(0, range(os.cpu_count() or 1))
    os.nice(NICENESS)
    robot, job = pickle.loads((folder / JOB).read_bytes())
    try:
        outcome = solve(job, RobotModel.load(robot))
    except PoiseError as error:
        outcome = refuse(str(error), {})
    except Exception as error:  # answered as well: nobody sees this process
        traceback.print_exc()
        outcome = refuse(f"{type(error).__name__}: {error}", {})
    (folder / OUTCOME).write_bytes(pickle.dumps(outcome))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
