"""Services that calibrate: they answer when the calibration is over, and meanwhile the estimator goes on."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from typing import Any

from std_msgs.msg import String
from std_srvs.srv import Trigger

from controllers.calibration.outcome import Outcome
from controllers.calibration.procedure import CalibrationProcedure
from controllers.calibration.session import WHATS
from controllers.nodes.calibration_solver import CalibrationSolver
from models.calibration import Calibration
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import CalibrationFile
from models.nodes.calibration_text import reply_to_text
from models.nodes.deferred import Owed, serve_later
from models.nodes.qos import EVENT, LATCHED
from models.types import CommandReply, SensorData

PERIOD = 0.02
"""Between two looks at the calibration that runs [s]."""


def trigger_response(reply: CommandReply) -> Any:
    """std_srvs/Trigger of a reply."""
    return Trigger.Response(success=reply.accepted, message=reply_to_text(reply))


class CalibrationRun:
    """Services ``calibrate/{imu,joints,feet}`` (std_srvs/Trigger), one at a time, whoever else begins one.

    Motions are asked of the supervisor by text, and their end is learnt from the topics that everybody hears.

    Args:
        node: Node that offers them.
        file: Where the result goes.

    Attributes:
        what: What is being calibrated; empty when nothing is.
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
        for topic in (topics.MOTION_STATE, topics.MOTION_PLAN_STATE):
            node.listen(String, topic, self._on_motion_state, EVENT)
        for what in WHATS:
            serve_later(node, Trigger, f"calibrate/{what}", partial(self._on_calibrate, what))
        node.own(node.destroy_timer, node.every(PERIOD, self._update))
        node.own(CalibrationSolver.close, self._solver)

    def add(self, raw: SensorData | None) -> None:
        """Take a sample as measured; None when what the drivers subtract from their encoders is unknown."""
        if raw is not None:
            self._procedure.add(raw)

    def _on_calibrate(self, what: str, request: Any, response: Any) -> Any:
        return self.begin(what, trigger_response)

    def begin(self, what: str, respond: Callable[[CommandReply], Any], *, save: bool = True) -> Any:
        """Begin a calibration.

        Args:
            what: 'imu', 'joints' or 'feet'.
            respond: Makes the response of a service of a reply.
            save: Whether what is found is kept.

        Returns:
            The response of a refusal, or an ``Owed`` for the answer.
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
        """Look at the calibration that runs: a motion to ask for, numbers to work out, an answer to give."""
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
        """Write what was found."""
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
        """The mode of a robot whose drivers are active, or what else becomes of it."""
        return self._mode if self._driver_state == topics.ACTIVE else self._driver_state

    def _on_motion_state(self, message: String) -> None:
        word, _, reason = message.data.partition(": ")
        self._procedure.on_motion(word, reason)
