"""Calibration in the estimator node: services, motions, samples, and a solver in a separate process."""

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

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.calibration.session import WHATS, CalibrationJob, CalibrationProcedure, solve
from controllers.calibration.windows import Outcome, name_and_unit, refuse
from models.calibration import Calibration, correct_encoders
from models.calibration_store import CalibrationStore
from models.errors import ConfigError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import CalibrationFile
from models.nodes.calibration_text import calibration_to_reply, reply_to_text
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec
from models.nodes.qos import EVENT, LATCHED
from models.nodes.realtime import die_with_parent
from models.nodes.services import PACKAGE, Owed, offer_own, own_message, serve_later
from models.robot_model import RobotModel
from models.status import MotionStatus
from models.types import CommandReply, SensorData, Vector

PERIOD = 0.02  #: Update period of a running calibration [s]

#: Actions on the files by name: function, and the word before the path in the answer
FILE_ACTS: dict[str, tuple[Callable[[CalibrationStore], Calibration], str]] = {
    "show": (lambda store: store.load()[0], "in"),
    "rollback": (CalibrationStore.rollback, "back in"),
}


def trigger_response(reply: CommandReply) -> Any:
    """Response of std_srvs/Trigger."""
    return Trigger.Response(success=reply.accepted, message=reply_to_text(reply))


def calibrate_response(reply: CommandReply) -> Any:
    """Response of poise_interfaces/Calibrate."""
    response = interface(PACKAGE, "srv", "Calibrate").Response(success=reply.accepted, message=reply.reason)
    kind = own_message("NamedValue")
    numbers = ((*name_and_unit(text), value) for text, value in reply.details.items())
    response.values = [kind(name=name, unit=unit, value=value) for name, unit, value in numbers]
    return response


class CalibrationServices:
    """Corrects IMU and feet; the drivers correct the joints, because all nodes use their encoders.

    Services (std_srvs/Trigger): ``calibrate/{imu,joints,feet}``, one at a time, ``calibrate/show`` and
    ``calibrate/rollback``; and ``calibrate`` (poise_interfaces/Calibrate), which covers all of them. Motions are
    requested from the supervisor as text commands and tracked on ``motion/status``. Built in ``configure`` of the node.
    ``start_over`` restarts the estimator after a change of the encoder offsets in the drivers. ``applied`` is the
    correction in force, None before the first start.
    """

    def __init__(self, node: PoiseNode, start_over: Callable[[], None]) -> None:
        self._node, self._start_over = node, start_over
        self._file, self._codec = CalibrationFile(node), JointStateCodec(node.model)
        self._procedure, self._solver = CalibrationProcedure(node.model), CalibrationSolver(node.robot)
        self.applied: Calibration | None = None
        self._encoder_offsets: Vector | None = None
        self._what = ""  # part under calibration
        self._owed, self._save_it = Owed(), True
        self._respond: Callable[[CommandReply], Any] = trigger_response
        self._mode = self._driver_state = ""
        self._commands = node.announce(String, topics.HUMANOID_COMMANDS, EVENT)
        node.listen(JointState, topics.ENCODER_OFFSETS, self._on_encoder_offsets, LATCHED, raw=True)
        node.listen(String, topics.MODE, self._on_mode, LATCHED)
        node.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        node.listen(String, topics.MOTION_REQUEST, lambda message: self._procedure.on_request(message.data), EVENT)
        node.listen_status(MotionStatus, topics.MOTION_STATUS, self._procedure.on_motion)
        for what in (*WHATS, *FILE_ACTS):
            serve_later(node, Trigger, f"calibrate/{what}", partial(self._on_trigger, what))
        offer_own(node, "Calibrate", topics.CALIBRATE, self._on_calibrate, serve_later)
        node.own(node.destroy_timer, node.every(PERIOD, self._update))
        node.own(CalibrationSolver.close, self._solver)

    def start(self) -> None:
        """Load the newest calibration when the estimator starts; ``ConfigError`` without a folder for the files."""
        self.applied = self._file.read().without_joints()

    def collect(self, sensors: SensorData) -> None:
        """Pass a sample to the running calibration, with the encoder offsets of the drivers removed."""
        if self._what and self._encoder_offsets is not None:
            self._procedure.add(correct_encoders(sensors, -self._encoder_offsets))

    def _on_trigger(self, what: str, request: Any, response: Any) -> Any:
        return self._begin(what, trigger_response)

    def _on_calibrate(self, request: Any, response: Any) -> Any:
        """Serve all calibration services by name, with units of the values; see ``Calibrate.srv``."""
        return self._begin(request.what, calibrate_response, save=request.save)

    def _begin(self, what: str, respond: Callable[[CommandReply], Any], *, save: bool = True) -> Any:
        """Act on a file, or begin the calibration ``what``: 'imu', 'joints' or 'feet'.

        ``respond`` converts a reply into the service's response; the result is stored when ``save`` is set. Returns the
        response of a refusal, or an ``Owed`` for the later answer.
        """
        if what in FILE_ACTS:
            return respond(self._file_reply(what))
        if self._what:
            reply = CommandReply(False, f"calibration of '{what}' refused: '{self._what}' is being calibrated")
        elif save and self._file.store is None:
            reply = CommandReply(False, f"calibration of '{what}' refused: calibration_dir is 'none'")
        elif not self._node.active:
            reply = CommandReply(False, f"calibration of '{what}' refused: the node is not active")
        else:
            reply = self._procedure.begin(what, self._situation)
        if reply.accepted:
            self._what, self._owed, self._save_it, self._respond = what, Owed(), save, respond
            return self._owed
        return respond(reply)

    def _file_reply(self, what: str) -> CommandReply:
        """Reply with the values of a calibration file; the next start applies them."""
        act, where = FILE_ACTS[what]
        try:
            store = self._file.store
            if store is None:
                raise ConfigError("calibration_dir is 'none'")
            return calibration_to_reply(act(store), self._node.model, f"{where} {store.path}")
        except PoiseError as error:
            return CommandReply(False, str(error))

    def _update(self) -> None:
        """Advance the running calibration: request a motion, start the solver, or answer."""
        if not self._what:
            return
        procedure = self._procedure
        procedure.wait(PERIOD)
        motion = procedure.take_motion()
        if motion:
            self._commands.publish(String(data=motion))
        if procedure.problem or not self._node.active:
            self._answer(CommandReply(False, procedure.problem or "calibration aborted: the node is not active"))
        elif procedure.ready:
            store = self._file.store
            base = Calibration.none(self._node.model) if store is None else store.load()[0]
            try:
                self._solver.start(procedure.job(base))
            except OSError as error:  # no disk space or no process: the estimator continues
                self._answer(
                    CommandReply(False, f"calibration aborted: the solver cannot be started: {error.strerror}")
                )
        outcome = self._solver.poll()
        if outcome is not None:
            self._answer(self._save(outcome))

    def _save(self, outcome: Outcome) -> CommandReply:
        reply, store = outcome.reply, self._file.store
        if outcome.calibration is not None and not self._save_it:
            return CommandReply(True, f"{reply.reason}; not stored, as requested", reply.details)
        if outcome.calibration is None or store is None:
            return reply
        try:
            store.save(outcome.calibration, now=datetime.now(UTC), what=self._what)
        except PoiseError as error:
            return CommandReply(False, f"{reply.reason}; not stored: {error}", reply.details)
        return CommandReply(True, f"{reply.reason}; takes effect at the next start ({store.path})", reply.details)

    def _answer(self, reply: CommandReply) -> None:
        self._node.get_logger().info(f"calibrate/{self._what}: {reply.reason}")
        self._procedure.end()
        self._solver.close()
        self._what = ""
        self._owed.answer(self._respond(reply))

    def _on_encoder_offsets(self, data: bytes) -> None:
        """Store the offsets that the drivers subtract; a change restarts the estimator, because positions jump."""
        offsets = self._codec.decode(data)[1]
        before, self._encoder_offsets = self._encoder_offsets, offsets
        if before is not None and not np.array_equal(before, offsets) and self._node.active:
            self._start_over()

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
JOB, OUTCOME = "job", "outcome"  #: Files exchanged by the two processes; a pipe would block the control loop


class CalibrationSolver:
    """Runs ``solve`` in a separate process. ``robot`` is a profile's name or path."""

    def __init__(self, robot: str) -> None:
        self._robot = robot
        self._process: subprocess.Popen[bytes] | None = None
        self._folder: tempfile.TemporaryDirectory[str] | None = None

    def start(self, job: CalibrationJob) -> None:
        """Start to solve a calibration; ends a previous one."""
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
        """End the process, also during a calibration."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        if self._folder is not None:
            self._folder.cleanup()
        self._process = self._folder = None


def main(folder: Path) -> None:
    """Body of the process, without the real-time priority and the cores of the control loop."""
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
    except Exception as error:  # reported in the answer: this process has no log
        traceback.print_exc()
        outcome = refuse(f"{type(error).__name__}: {error}", {})
    (folder / OUTCOME).write_bytes(pickle.dumps(outcome))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
