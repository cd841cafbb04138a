"""What the estimator's node does about calibration: corrects its samples, and offers the calibration services."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from controllers.calibration.session import WHATS
from models.calibration import Calibration, apply_calibration
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import CalibrationFile
from models.nodes.messages import JointStateCodec
from models.nodes.qos import LATCHED
from models.types import SensorData, Vector


class CalibrationServices:
    """Corrects inertial unit and feet; the joints' part is the drivers', whose encoders everybody shares.

    Args:
        node: Node that estimates; to be built in its ``configure``.
        start_over: Has the estimator start over, because the drivers now read their encoders otherwise.
    """

    def __init__(self, node: PoiseNode, start_over: Callable[[], None]) -> None:
        self._node, self._start_over = node, start_over
        self._file = CalibrationFile(node)
        self._codec = JointStateCodec(node.model)
        self._applied: Calibration | None = None
        self._encoder_offsets: Vector | None = None
        node.listen(JointState, topics.ENCODER_OFFSETS, self._on_encoder_offsets, LATCHED, raw=True)
        for what in WHATS:
            node.serve(Trigger, f"calibrate/{what}", self._callback(what))

    def start(self) -> None:
        """Take the newest calibration: the estimator starts, or starts over.

        Raises:
            ConfigError: There is no folder for calibration files.
        """
        self._applied = self._file.read().without_joints()

    def correct(self, sensors: SensorData) -> SensorData:
        """The sample as the estimator is to see it."""
        return sensors if self._applied is None else apply_calibration(sensors, self._applied)

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

    def _callback(self, what: str) -> Callable[[Any, Any], Any]:
        def on_calibrate(request: Any, response: Any) -> Any:
            response.success = False
            response.message = f"calibrate/{what} is not available yet: this estimator takes the profile's calibration"
            return response

        return on_calibrate
