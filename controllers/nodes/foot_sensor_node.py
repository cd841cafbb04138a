"""Node ``foot_sensor_node``: ground reactions in; contact and centre of pressure of each foot out."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, WrenchStamped
from std_msgs.msg import Bool, String

from controllers.estimation.assembler import FootPairs
from controllers.estimation.config import ContactConfig, EstimatorConfig
from controllers.estimation.feet import UNKNOWN, ContactDetector
from controllers.nodes.estimate_topics import Due
from models.config import default_config
from models.errors import ConfigError, PoiseError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import WrenchCodec, set_stamp
from models.nodes.parameters import declare_config, describe
from models.nodes.qos import LATCHED, SENSOR
from models.nodes.spin import run
from models.robot_model import SOLE_FRAMES
from models.types import FOOT_NAMES

SOUND, NO_SCHEDULE = np.zeros(2), np.full(2, UNKNOWN)  #: For each foot: a valid sample, and no expectation from a gait


class FootSensorNode(PoiseNode):
    """Runs the ``ContactDetector`` of the estimator on the foot sensors alone.

    The state estimator publishes ``contacts``, which also considers the leg torques; this node has separate topics for
    each foot. For a silent sensor nothing is published.
    """

    AUTOSTART = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("foot_sensor_node", **kwargs)
        self._defaults = default_config(EstimatorConfig, "controllers", "estimator")
        self._contact: ContactConfig = declare_config(self, self._defaults.contact, "contact.")
        text = describe("Rate of contacts without a change, and of centres of pressure [Hz]", low=1.0, high=1000.0)
        self._period = round(NANOSECONDS / float(self.declare_parameter("rate", 100.0, text).value))
        text = describe("Age of a foot's sample against the other's above which it counts as silent [s]", low=0.001)
        self._max_age = round(NANOSECONDS * float(self.declare_parameter("max_age", 0.005, text).value))
        text = describe("Largest step of a stamp that is accepted at once [s]", low=0.001, high=1.0)
        self._max_gap = round(NANOSECONDS * float(self.declare_parameter("max_gap", 0.05, text).value))

    def configure(self) -> None:
        """Build the law, the codecs and the topics."""
        if not self.model.profile.sensors.feet.fitted:
            raise ConfigError(f"{self.robot}: its profile says that no foot sensors are fitted (sensors.feet.fitted)")
        known = self._defaults
        self._law = ContactDetector(self.model, self._contact, known.foot_sensors, known.foot, known.gravity)
        self._contacts = [self.announce(Bool, topic, SENSOR) for topic in topics.FOOT_CONTACTS]
        self._cops = [self.announce(PointStamped, topic, SENSOR) for topic in topics.FOOT_COPS]
        for foot, topic in enumerate(topics.FOOT_WRENCHES):
            self.listen(WrenchStamped, topic, self.foot_callback(foot), SENSOR, raw=True)
        self.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)

    def activate(self) -> None:
        """Start from the next samples."""
        self._pairs = FootPairs(self._max_age, self._max_gap)
        self._due = Due(self._period)
        self._told: list[bool | None] = [None, None]
        self._reported = 0

    def foot_callback(self, foot: int) -> Callable[[bytes], None]:
        """Callback for the serialised samples of a foot."""
        codec, topic = WrenchCodec(SOLE_FRAMES[foot]), topics.FOOT_WRENCHES[foot]

        def on_foot(data: bytes) -> None:
            if not self.active:
                return
            try:
                dt = self._pairs.add(foot, *codec.decode(data))
            except PoiseError as error:
                self.refuse(topic, error)
                return
            if dt is not None:
                self._step(dt)

        return on_foot

    def _step(self, dt: float) -> None:
        pairs, law = self._pairs, self._law
        if dt > 0.0:
            law.update(pairs.wrenches, SOUND, SOUND, NO_SCHEDULE, dt)
        else:
            law.reset(pairs.wrenches, SOUND)
        due = self._due(pairs.stamp)
        for foot in range(2):
            if pairs.silent[foot]:
                self._told[foot] = None
                continue
            bears = bool(law.active[foot])
            if due or bears != self._told[foot]:
                self._told[foot] = bears
                self._contacts[foot].publish(Bool(data=bears))
            if due and bears:
                self._publish_cop(foot)

    def _publish_cop(self, foot: int) -> None:
        message = PointStamped()
        message.header.frame_id = SOLE_FRAMES[foot]
        set_stamp(message.header.stamp, self._pairs.stamp)
        message.point.x, message.point.y = self._law.cops[foot].tolist()
        self._cops[foot].publish(message)

    def _on_driver_state(self, message: String) -> None:
        """Start over when the simulated robot has been reset."""
        if message.data == topics.HELD and self.active:
            self.activate()

    def before_diagnostics(self) -> None:
        """Report the feet in contact and the silent sensors."""
        if not self.active:
            return
        pairs = self._pairs
        if pairs.stamp == self._reported:  # nothing since the last report
            pairs.silent[:], self._told[:] = [True, True], [None, None]
        self._reported = pairs.stamp
        silent = [name for name, quiet in zip(FOOT_NAMES, pairs.silent, strict=True) if quiet]
        self.level = DiagnosticStatus.ERROR if silent else DiagnosticStatus.OK
        self.message = f"silent: {', '.join(silent)}" if silent else "detecting contacts"
        for foot, name in enumerate(FOOT_NAMES):
            self.values[f"{name} bears"] = "unknown" if self._told[foot] is None else str(self._told[foot])


def main(args: list[str] | None = None) -> None:
    """Run the node in a separate process."""
    sys.exit(run([FootSensorNode], args))


if __name__ == "__main__":
    main()
