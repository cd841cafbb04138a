"""Node ``state_estimator``: joints, inertial unit and feet in; odometry, contacts, orientation and transforms out."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from std_msgs.msg import String

from controllers.estimation.config import EstimatorConfig
from controllers.estimation.estimator import StateEstimator
from controllers.nodes.calibration_services import CalibrationServices
from controllers.nodes.estimate_topics import EstimateTopics, declare_rates
from controllers.nodes.estimator_report import EstimatorReport
from controllers.nodes.sample_topics import SampleTopics, declare_ages
from controllers.sample_assembler import mean_sample
from models.applied import Applied
from models.config import default_config
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.parameters import declare_config, describe
from models.nodes.qos import EVENT, LATCHED
from models.nodes.spin import run
from models.types import RobotState, SensorData


class StateEstimatorNode(PoiseNode):
    """Runs ``StateEstimator`` once for each complete set of samples.

    Args:
        hand_over: Called with every state and its stamp [ns] when the controller lives in this process; returns which
            feet its reference has in contact, None for no plan. ``/odom`` is then published at ``odom_rate`` only.
        applied: Notes what the laws of this process are told, for a replay; None for nobody.
        kwargs: Passed to rclpy.

    Attributes:
        sensors: What the newest state was made from; None before the first.
    """

    def __init__(
        self,
        hand_over: Callable[[RobotState, int], tuple[bool, bool] | None] | None = None,
        applied: Applied | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__("state_estimator", **kwargs)
        self._hand_over, self._applied = hand_over, applied
        self._config = declare_config(self, default_config(EstimatorConfig, "controllers", "estimator"))
        self._lockstep = topics.declare_lockstep(self)
        self._rates = declare_rates(self, shared=hand_over is not None, lockstep=self._lockstep)
        self._ages = declare_ages(self)
        count = describe("Samples averaged for the start, at rest (lockstep: 1)", integer=(1, 10000))
        self._start_samples = 1 if self._lockstep else int(self.declare_parameter("start_samples", 100, count).value)
        self._first: list[SensorData] = []
        self.sensors: SensorData | None = None
        self._state: RobotState | None = None
        self._scheduled: tuple[bool, bool] | None = None
        self._last_stamp = 0

    def configure(self) -> None:
        """Build the law, the codecs and the topics."""
        self._law = StateEstimator(self.model, self._config)
        self._estimates = EstimateTopics(self, self._law, self._rates, lockstep=self._lockstep)
        self._samples = SampleTopics(self, self._ages, self._step, self._again, lockstep=self._lockstep)
        self._report = EstimatorReport(self)
        self.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        self._calibration = CalibrationServices(self, self.activate)
        if self._applied is not None:
            self._applied.describe("estimator", self._config)
            self._applied.watch("estimator", self._law)
            self._notes = self.announce(String, topics.APPLIED, EVENT)

    def activate(self) -> None:
        """Start from the next complete sample, with the newest calibration."""
        self._calibration.start()
        self._first.clear()
        self._state = self._scheduled = None
        self._samples.reset()
        self._report.reset()

    def before_diagnostics(self) -> None:
        """Report what the estimator met."""
        if self.active:
            self.message = "waiting for a complete sample" if self._state is None else "estimating"
            self._report.fill(self._law, self._samples.assembler)

    def _step(self, sensors: SensorData, stamp: int) -> None:
        """Estimate the state of a tick; the first ones, averaged, are what the law starts from."""
        self.sensors = sensors = self._calibration.correct(sensors)
        if self._state is not None:
            dt = (stamp - self._last_stamp) / NANOSECONDS
            self._state = self._law.step(sensors, dt, self._scheduled)
            self._note_step(dt)
        elif not self._starts_from(sensors):
            return
        else:
            first, self._first = self._first, []
            sample = mean_sample(first)
            self._state = self._law.reset(sample)
            self._estimates.start(stamp)
            self._note_start(sample)
        self._last_stamp = stamp
        if self._hand_over is not None:
            self._scheduled = self._hand_over(self._state, stamp)
        self._estimates.publish(self._state, stamp, sensors)
        self._report.update(self._law.health, stamp)
        self._tell(stamp)

    def _tell(self, stamp: int, *, again: bool = False) -> None:
        """Publish what has been noted, once the command is out."""
        if self._applied is not None and (text := self._applied.take(stamp, again=again)):
            self._notes.publish(String(data=text))

    def _note_start(self, sample: SensorData) -> None:
        """Note what the law starts from."""
        if self._applied is not None:
            self._applied.begin(self.robot, sample, calibration=self._calibration.applied, after=self._last_stamp)
            self._applied.estimated()

    def _note_step(self, dt: float) -> None:
        """Note a step [s] and a sample that are not as they mostly are."""
        if self._applied is None:
            return
        if mixed := self._samples.assembler.mixed:
            self._applied.note("sample", mixed)
        self._applied.note_change("dt", dt)
        self._applied.estimated()

    def _starts_from(self, sensors: SensorData) -> bool:
        """Keep one more sample for the start; whether they are enough. One with a silent sensor begins anew."""
        if not self._samples.assembler.whole:
            self._first.clear()
            return False
        self._first.append(sensors)
        return len(self._first) >= self._start_samples

    def _again(self) -> None:
        """Answer a tick once more."""
        if self._state is None:
            return
        if self._hand_over is not None:
            if self._applied is not None:
                self._applied.estimated()
            self._hand_over(self._state, self._last_stamp)
            self._tell(self._last_stamp, again=True)
        self._estimates.publish_odometry(self._state, self._last_stamp)

    def _on_driver_state(self, message: String) -> None:
        """Start over when the robot has been put back to its start, from wherever it was."""
        if message.data == topics.HELD and self._state is not None:
            self.activate()


def main(args: list[str] | None = None) -> None:
    """Run the node in a process of its own."""
    sys.exit(run([StateEstimatorNode], args))


if __name__ == "__main__":
    main()
