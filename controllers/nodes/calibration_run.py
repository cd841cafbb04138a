"""Services ``calibrate/{imu,joints,feet}``: motions, samples, and a solver in a separate process."""

import contextlib
import os
import pickle
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.calibration.session import WHATS, CalibrationJob, CalibrationProcedure, solve
from controllers.calibration.windows import Outcome, refuse
from models.calibration import Calibration
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import CalibrationFile
from models.nodes.calibration_text import reply_to_text
from models.nodes.qos import EVENT, LATCHED
from models.nodes.realtime import die_with_parent
from models.nodes.services import Owed, serve_later
from models.robot_model import RobotModel
from models.status import MotionStatus
from models.types import CommandReply, SensorData

PERIOD = 0.02  #: Update period of a running calibration [s]


def trigger_response(reply: CommandReply) -> Any:
    """std_srvs/Trigger of a reply."""
    return Trigger.Response(success=reply.accepted, message=reply_to_text(reply))


class CalibrationRun:
    """Services ``calibrate/{imu,joints,feet}`` (std_srvs/Trigger), one calibration at a time.

    Motions are requested from the supervisor as text commands and followed on ``motion/status``. ``file`` receives the
    result; ``what`` names the running calibration, empty when idle.
    """

    def __init__(self, node: PoiseNode, file: CalibrationFile) -> None:
        self._node, self._file = node, file
        self._procedure, self._solver = CalibrationProcedure(node.model), CalibrationSolver(node.robot)
        self.what = ""
        self._owed, self._save_it = Owed(), True
        self._respond: Callable[[CommandReply], Any] = trigger_response
        self._mode = self._driver_state = ""
        self._commands = node.announce(String, topics.HUMANOID_COMMANDS, EVENT)
        node.listen(String, topics.MODE, self._on_mode, LATCHED)
        node.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        node.listen(String, topics.MOTION_REQUEST, lambda message: self._procedure.on_request(message.data), EVENT)
        node.listen_status(MotionStatus, topics.MOTION_STATUS, self._procedure.on_motion)
        for what in WHATS:
            serve_later(node, Trigger, f"calibrate/{what}", partial(self._on_calibrate, what))
        node.own(node.destroy_timer, node.every(PERIOD, self._update))
        node.own(CalibrationSolver.close, self._solver)

    def add(self, raw: SensorData | None) -> None:
        """Add a sample as measured; None when the encoder offsets of the drivers are unknown."""
        if raw is not None:
            self._procedure.add(raw)

    def _on_calibrate(self, what: str, request: Any, response: Any) -> Any:
        return self.begin(what, trigger_response)

    def begin(self, what: str, respond: Callable[[CommandReply], Any], *, save: bool = True) -> Any:
        """Begin the calibration ``what``: 'imu', 'joints' or 'feet'.

        ``respond`` converts a reply into the service's response; the result is stored when ``save`` is set. Returns the
        response of a refusal, or an ``Owed`` for the later answer.
        """
        if self.what:
            reply = CommandReply(False, f"calibration of '{what}' refused: '{self.what}' is being calibrated")
        elif save and self._file.store is None:
            reply = CommandReply(False, f"calibration of '{what}' refused: calibration_dir is 'none'")
        elif not self._node.active:
            reply = CommandReply(False, f"calibration of '{what}' refused: the node is not active")
        else:
            reply = self._procedure.begin(what, self._situation)
        if reply.accepted:
            self.what, self._owed, self._save_it, self._respond = what, Owed(), save, respond
            return self._owed
        return respond(reply)

    def _update(self) -> None:
        """Advance the running calibration: request a motion, start the solver, or answer."""
        if not self.what:
            return
        procedure = self._procedure
        procedure.wait(PERIOD)
        motion = procedure.take_motion()
        if motion:
            self._commands.publish(String(data=motion))
        if procedure.problem or not self._node.active:
            self._answer(CommandReply(False, procedure.problem or "calibration given up: the node is not active"))
        elif procedure.ready:
            store = self._file.store
            base = Calibration.none(self._node.model) if store is None else store.load()[0]
            try:
                self._solver.start(procedure.job(base))
            except OSError as error:  # no room, no process: no reason to stop estimating
                self._answer(CommandReply(False, f"calibration given up: the solver does not start: {error.strerror}"))
        outcome = self._solver.poll()
        if outcome is not None:
            self._answer(self._save(outcome))

    def _save(self, outcome: Outcome) -> CommandReply:
        reply, store = outcome.reply, self._file.store
        if outcome.calibration is not None and not self._save_it:
            return CommandReply(True, f"{reply.reason}; not kept, as asked", reply.details)
        if outcome.calibration is None or store is None:
            return reply
        try:
            store.save(outcome.calibration, now=datetime.now(UTC), what=self.what)
        except PoiseError as error:
            return CommandReply(False, f"{reply.reason}; not kept: {error}", reply.details)
        return CommandReply(True, f"{reply.reason}; in effect at the next start ({store.path})", reply.details)

    def _answer(self, reply: CommandReply) -> None:
        self._node.get_logger().info(f"calibrate/{self.what}: {reply.reason}")
        self._procedure.end()
        self._solver.close()
        self.what = ""
        self._owed.answer(self._respond(reply))

    def _on_mode(self, message: String) -> None:
        self._mode = message.data
        self._procedure.on_situation(self._situation)

    def _on_driver_state(self, message: String) -> None:
        self._driver_state = message.data
        self._procedure.on_situation(self._situation)

    @property
    def _situation(self) -> str:
        """The mode while the drivers are active, otherwise the drivers' state."""
        return self._mode if self._driver_state == topics.ACTIVE else self._driver_state


NICENESS = 10  #: Niceness of the solver: it yields to all other processes
JOB, OUTCOME = "job", "outcome"  #: Files that the two processes exchange; a pipe would block the one with the tick


class CalibrationSolver:
    """Runs ``solve`` in a separate process. ``robot`` is a profile's name or path."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def start(self, job: CalibrationJob) -> None:
        """Begin to solve a calibration; one at a time."""
        self.close()
        self._folder = tempfile.TemporaryDirectory(prefix="poise_solver_")
        (Path(self._folder.name) / JOB).write_bytes(pickle.dumps((self._robot, job)))
        self._process = subprocess.Popen([sys.executable, "-m", __spec__.name, self._folder.name])

    def poll(self) -> Outcome | None:
        """The outcome, once; None while solving or idle."""
        if self._process is None or self._folder is None or self._process.poll() is None:
            return None
        try:
            outcome: Outcome = pickle.loads((Path(self._folder.name) / OUTCOME).read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            outcome = refuse(f"the calculation ended with code {self._process.returncode}", {})
        self.close()
        return outcome

    def close(self) -> None:
        """End the process, also in the middle of a calibration."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._folder is not None:
            self._folder.cleanup()
        self._process = self._folder = None


def main(folder: Path) -> None:
    """Body of the process, without the control loop's real-time priority and cores."""
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
    except Exception as error:  # reported as an answer: this process has no log
        traceback.print_exc()
        outcome = refuse(f"{type(error).__name__}: {error}", {})
    (folder / OUTCOME).write_bytes(pickle.dumps(outcome))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
