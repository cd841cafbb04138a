"""Node ``foot_sensor_node``: ground reactions in; contact and centre of pressure of each foot out."""

from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, WrenchStamped
from std_msgs.msg import Bool

from controllers.estimation.assembler import FootPairs
from controllers.estimation.config import ContactConfig, EstimatorConfig
from controllers.estimation.feet import UNKNOWN, ContactDetector
from controllers.estimation.stamps import Due
from models.config import default_config
from models.constants import FOOT_NAMES
from models.errors import ConfigError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import WrenchCodec, set_header
from models.nodes.parameters import declare_config, declare_ns, declare_period
from models.nodes.qos import SENSOR, STATE
from models.nodes.spin import program
from models.robot_model import SOLE_FRAMES

SOUND, NO_SCHEDULE = np.zeros(2), np.full(2, UNKNOWN)  #: For each foot: a valid sample, and no gait schedule


class FootSensorNode(PoiseNode):
    """Runs the ``ContactDetector`` of the estimator on the foot sensors alone.

    The state estimator publishes ``contacts``, which also uses the leg torques; this node has separate topics for each
    foot. Nothing is published for a silent sensor.
    """

    AUTOSTART = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("foot_sensor_node", **kwargs)
        self._defaults = default_config(EstimatorConfig, "controllers", "estimator")
        self._contact: ContactConfig = declare_config(self, self._defaults.contact, "contact.")
        self._period = declare_period(self, "rate", 100.0, "contacts without a change, and of centres of pressure")
        text = "Age difference between the samples of the feet above which the older foot counts as silent [s]"
        self._age_max = declare_ns(self, "age_max", 0.005, text, low=0.001)
        text = "Largest step of a stamp that is accepted at once [s]"
        self._gap_max = declare_ns(self, "gap_max", 0.05, text, low=0.001, high=1.0)

    def configure(self) -> None:
        if not self.model.profile.sensors.feet.fitted:
            raise ConfigError(f"{self.robot}: the profile has no foot sensors (sensors.feet.fitted)")
        fixed = self._defaults
        self._law = ContactDetector(self.model, self._contact, fixed.foot_sensors, fixed.foot, fixed.gravity)
        self._contacts = [self.announce(Bool, topic, STATE) for topic in topics.FOOT_CONTACTS]
        self._cops = [self.announce(PointStamped, topic, STATE) for topic in topics.FOOT_COPS]
        for foot, topic in enumerate(topics.FOOT_WRENCHES):
            on_wrench = partial(self._on_wrench, foot, WrenchCodec(SOLE_FRAMES[foot]))
            self.listen(WrenchStamped, topic, on_wrench, SENSOR, raw=True, while_active=True)
        self.listen_start(self.activate)

    def activate(self) -> None:
        self._pairs = FootPairs(self._age_max, self._gap_max)
        self._due = Due(self._period)
        self._bearing: list[bool | None] = [None, None]
        self._reported = 0

    def _on_wrench(self, foot: int, codec: WrenchCodec, data: bytes) -> None:
        dt = self._pairs.add(foot, *codec.decode(data))
        if dt is not None:
            self._step(dt)

    def _step(self, dt: float) -> None:
        pairs, law = self._pairs, self._law
        if dt > 0.0:
            law.update(pairs.wrenches, SOUND, SOUND, NO_SCHEDULE, dt)
        else:
            law.reset(pairs.wrenches, SOUND)
        due = self._due(pairs.stamp)
        for foot in range(2):
            if pairs.silent[foot]:
                self._bearing[foot] = None
                continue
            bears = bool(law.active[foot])
            if due or bears != self._bearing[foot]:
                self._bearing[foot] = bears
                self._contacts[foot].publish(Bool(data=bears))
            if due and bears:
                self._publish_cop(foot)

    def _publish_cop(self, foot: int) -> None:
        message = PointStamped()
        set_header(message, self._pairs.stamp, SOLE_FRAMES[foot])
        message.point.x, message.point.y = self._law.cops[foot].tolist()
        self._cops[foot].publish(message)

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        stamp, reported, self._reported = self._pairs.stamp, self._reported, self._pairs.stamp
        if stamp == reported:
            self._bearing = [None, None]
        silent = [foot for foot, old in zip(FOOT_NAMES, self._pairs.silent, strict=True) if old or stamp == reported]
        self.level = DiagnosticStatus.ERROR if silent else DiagnosticStatus.OK
        self.message = f"silent: {', '.join(silent)}" if silent else "detecting contacts"
        for foot, name in enumerate(FOOT_NAMES):
            self.values[f"{name} bears"] = "unknown" if self._bearing[foot] is None else str(self._bearing[foot])


main = program(FootSensorNode)


if __name__ == "__main__":
    main()
