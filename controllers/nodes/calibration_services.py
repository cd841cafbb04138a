"""What the estimator's node does about calibration: corrects its samples, and offers the calibration services."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from controllers.calibration.units import name_and_unit
from controllers.nodes.calibration_run import CalibrationRun, trigger_response
from models.calibration import Calibration, apply_calibration, correct_encoders
from models.calibration_store import CalibrationStore
from models.errors import ConfigError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import CalibrationFile
from models.nodes.calibration_text import calibration_to_reply
from models.nodes.deferred import serve_later
from models.nodes.interfaces import interface
from models.nodes.messages import JointStateCodec
from models.nodes.own_types import PACKAGE, offer_own, own_message
from models.nodes.qos import LATCHED
from models.types import CommandReply, SensorData, Vector

FILE_ACTS: dict[str, tuple[Callable[[CalibrationStore], Calibration], str]] = {
    "show": (lambda store: store.load()[0], "in"),
    "rollback": (CalibrationStore.rollback, "back in"),
}
"""What can be done with the files, by name: what does it, and the word before the path in the answer."""


def calibrate_response(reply: CommandReply) -> Any:
    """poise_interfaces/Calibrate of a reply."""
    response = interface(PACKAGE, "srv", "Calibrate").Response(success=reply.accepted, message=reply.reason)
    kind = own_message("NamedValue")
    numbers = ((*name_and_unit(text), value) for text, value in reply.details.items())
    response.values = [kind(name=name, unit=unit, value=value) for name, unit, value in numbers]
    return response


class CalibrationServices:
    """Corrects inertial unit and feet; the joints' part is the drivers', whose encoders everybody shares.

    Services (std_srvs/Trigger): those of ``CalibrationRun``, ``calibrate/show`` and ``calibrate/rollback``; and
    ``calibrate`` (poise_interfaces/Calibrate), which is all of them.

    Args:
        node: Node that estimates; to be built in its ``configure``.
        start_over: Has the estimator start over, because the drivers now read their encoders otherwise.

    Attributes:
        applied: What the samples are corrected by; None before the first start.
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
        """Take the newest calibration: the estimator starts, or starts over.

        Raises:
            ConfigError: There is no folder for calibration files.
        """
        self.applied = self._file.read().without_joints()

    def correct(self, sensors: SensorData) -> SensorData:
        """The sample as the estimator is to see it; a calibration that runs gets it as measured."""
        if self._run.what:
            offsets = self._encoder_offsets
            self._run.add(None if offsets is None else correct_encoders(sensors, -offsets))
        return sensors if self.applied is None else apply_calibration(sensors, self.applied)

    def _on_calibrate(self, request: Any, response: Any) -> Any:
        """All of them by name, with numbers that have units; see ``Calibrate.srv``."""
        if request.what in FILE_ACTS:
            return calibrate_response(self._file_reply(request.what))
        return self._run.begin(request.what, calibrate_response, save=request.save)

    def _on_file(self, what: str, request: Any, response: Any) -> Any:
        return trigger_response(self._file_reply(what))

    def _file_reply(self, what: str) -> CommandReply:
        """Answer with the numbers of a file; the next start takes them."""
        act, where = FILE_ACTS[what]
        try:
            store = self._file.store
            if store is None:
                raise ConfigError("calibration_dir is 'none'")
            return calibration_to_reply(act(store), self._node.model, f"{where} {store.path}")
        except PoiseError as error:
            return CommandReply(False, str(error))

    def _on_encoder_offsets(self, data: bytes) -> None:
        """Note what the drivers subtract; positions that are suddenly read otherwise are no motion."""
        try:
            offsets = self._codec.decode(data)[1]
        except PoiseError as error:
            self._node.refuse(topics.ENCODER_OFFSETS, error)
            return
        before, self._encoder_offsets = self._encoder_offsets, offsets
        if before is not None and not np.array_equal(before, offsets) and self._node.active:
            self._start_over()
