"""Calibration in the estimator's node: corrects its samples, and offers the calibration services."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from controllers.calibration.windows import name_and_unit
from controllers.nodes.calibration_run import CalibrationRun, trigger_response
from models.calibration import Calibration, correct_encoders
from models.calibration_store import CalibrationStore
from models.errors import ConfigError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import CalibrationFile
from models.nodes.calibration_text import calibration_to_reply
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec
from models.nodes.qos import LATCHED
from models.nodes.services import PACKAGE, offer_own, own_message, serve_later
from models.types import CommandReply, SensorData, Vector

#: Actions on the files by name: function, and the word before the path in the answer
FILE_ACTS: dict[str, tuple[Callable[[CalibrationStore], Calibration], str]] = {
    "show": (lambda store: store.load()[0], "in"),
    "rollback": (CalibrationStore.rollback, "back in"),
}


def calibrate_response(reply: CommandReply) -> Any:
    """poise_interfaces/Calibrate of a reply."""
    response = interface(PACKAGE, "srv", "Calibrate").Response(success=reply.accepted, message=reply.reason)
    kind = own_message("NamedValue")
    numbers = ((*name_and_unit(text), value) for text, value in reply.details.items())
    response.values = [kind(name=name, unit=unit, value=value) for name, unit, value in numbers]
    return response


class CalibrationServices:
    """Corrects IMU and feet; joints are corrected by the drivers, whose encoders all nodes share.

    Services (std_srvs/Trigger): those of ``CalibrationRun``, ``calibrate/show`` and ``calibrate/rollback``; and
    ``calibrate`` (poise_interfaces/Calibrate), which covers all of them. Built in the node's ``configure``.
    ``start_over`` restarts the estimator after the encoder offsets of the drivers change; ``applied`` is the correction
    in force, None before the first start.
    """

    def __init__(self, node: PoiseNode, start_over: Callable[[], None]) -> None:
        self._node, self._start_over = node, start_over
        self._file, self._codec = CalibrationFile(node), JointStateCodec(node.model)
        self._run = CalibrationRun(node, self._file)
        self.applied: Calibration | None = None
        self._encoder_offsets: Vector | None = None
        node.listen(JointState, topics.ENCODER_OFFSETS, self._on_encoder_offsets, LATCHED, raw=True)
        for what in FILE_ACTS:
            node.serve(Trigger, f"calibrate/{what}", partial(self._on_file, what))
        offer_own(node, "Calibrate", topics.CALIBRATE, self._on_calibrate, serve_later)

    def start(self) -> None:
        """Load the newest calibration when the estimator starts; ``ConfigError`` without a folder for the files."""
        self.applied = self._file.read().without_joints()

    def collect(self, sensors: SensorData) -> None:
        """Pass a sample, as measured, to the running calibration."""
        if self._run.what:
            offsets = self._encoder_offsets
            self._run.add(None if offsets is None else correct_encoders(sensors, -offsets))

    def _on_calibrate(self, request: Any, response: Any) -> Any:
        """All services by name, with numbers that have units; see ``Calibrate.srv``."""
        if request.what in FILE_ACTS:
            return calibrate_response(self._file_reply(request.what))
        return self._run.begin(request.what, calibrate_response, save=request.save)

    def _on_file(self, what: str, request: Any, response: Any) -> Any:
        return trigger_response(self._file_reply(what))

    def _file_reply(self, what: str) -> CommandReply:
        """Reply with the numbers of a file; the next start applies them."""
        act, where = FILE_ACTS[what]
        try:
            store = self._file.store
            if store is None:
                raise ConfigError("calibration_dir is 'none'")
            return calibration_to_reply(act(store), self._node.model, f"{where} {store.path}")
        except PoiseError as error:
            return CommandReply(False, str(error))

    def _on_encoder_offsets(self, data: bytes) -> None:
        """Store the offsets that the drivers subtract; a jump of positions that they cause is no motion."""
        offsets = self._codec.decode(data)[1]
        before, self._encoder_offsets = self._encoder_offsets, offsets
        if before is not None and not np.array_equal(before, offsets) and self._node.active:
            self._start_over()
