"""Node ``state_estimator``: joints, IMU and feet in; odometry, contacts, orientation and transforms out."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from std_msgs.msg import String

from controllers.estimation.assembler import mean_sample
from controllers.estimation.config import EstimatorConfig
from controllers.nodes.calibration_services import CalibrationServices
from controllers.nodes.estimate_topics import EstimateTopics, declare_rates
from controllers.nodes.estimator_report import EstimatorReport
from controllers.nodes.sample_topics import SampleTopics, declare_ages
from controllers.stack import ControlStack
from models.config import default_config
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.parameters import declare_config, declare_lockstep, describe
from models.nodes.qos import EVENT, LATCHED
from models.nodes.spin import run
from models.types import RobotState, SensorData


class StateEstimatorNode(PoiseNode):
    """Runs ``StateEstimator`` once for each complete set of samples.

    ``hand_over`` is called with every state and its stamp [ns] when the controller runs in this process; ``/odom`` is
    then published at ``odom_rate`` only. ``stack`` is shared with that controller; when None, one with the estimator
    alone is made.
    """

    def __init__(
        self,
        hand_over: Callable[[RobotState, int], object] | None = None,
        stack: ControlStack | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__("state_estimator", **kwargs)
        self._hand_over, self._stack = hand_over, stack or ControlStack()
        self._config = declare_config(self, default_config(EstimatorConfig, "controllers", "estimator"))
        self._lockstep = declare_lockstep(self)
        self._rates = declare_rates(self, shared=hand_over is not None, lockstep=self._lockstep)
        self._ages = declare_ages(self)
        count = describe("Samples averaged for the start, at rest (lockstep: 1)", integer=(1, 10000))
        self._start_samples = 1 if self._lockstep else int(self.declare_parameter("start_samples", 100, count).value)
        self._first: list[SensorData] = []
        self._state: RobotState | None = None
        self._last_stamp = 0

    def configure(self) -> None:
        """Build the law, the codecs and the topics."""
        law = self._stack.build_estimator(self.model, self._config)
        self._estimates = EstimateTopics(self, law, self._rates, lockstep=self._lockstep)
        self._samples = SampleTopics(self, self._ages, self._step, self._again, lockstep=self._lockstep)
        self._report = EstimatorReport(self)
        self.listen(String, topics.DRIVER_STATE, self._on_driver_state, LATCHED)
        self._calibration = CalibrationServices(self, self.activate)
        if self._stack.log is not None:
            self._inputs = self.announce(String, topics.APPLIED, EVENT)

    def activate(self) -> None:
        """Start from the next complete sample, with the newest calibration."""
        self._calibration.start()
        self._first.clear()
        self._state = None
        self._samples.reset()
        self._report.reset()

    def before_diagnostics(self) -> None:
        """Report the estimator's health."""
        if self.active:
            self.message = "waiting for a complete sample" if self._state is None else "estimating"
            self._report.fill(self._stack.estimator, self._samples.assembler)

    def _step(self, sensors: SensorData, stamp: int) -> None:
        """Estimate the state of a tick; the law starts from the mean of the first ones."""
        self._calibration.collect(sensors)
        stack = self._stack
        if self._state is not None:
            if stack.log is not None and (mixed := self._samples.assembler.mixed):
                stack.log.note("sample", mixed)
            self._state = stack.estimate(sensors, (stamp - self._last_stamp) / NANOSECONDS)
        elif not self._starts_from(sensors):
            return
        else:
            first, self._first = self._first, []
            stack.calibration = self._calibration.applied
            self._state = stack.reset_estimator(mean_sample(first), after=self._last_stamp)
            self._estimates.start(stamp)
        self._last_stamp = stamp
        if self._hand_over is not None:
            self._hand_over(self._state, stamp)
        self._estimates.publish(self._state, stamp, stack.sensors)
        self._report.update(stack.estimator.health, stamp)
        self._publish_inputs(stamp)

    def _publish_inputs(self, stamp: int, *, again: bool = False) -> None:
        """Publish the inputs of a tick, once the command is out."""
        log = self._stack.log
        if log is not None and (text := log.take(stamp, again=again)):
            self._inputs.publish(String(data=text))

    def _starts_from(self, sensors: SensorData) -> bool:
        """Add a sample for the start; returns whether they are enough. A silent sensor discards them."""
        if not self._samples.assembler.whole:
            self._first.clear()
            return False
        self._first.append(sensors)
        return len(self._first) >= self._start_samples

    def _again(self) -> None:
        """Repeat the answer to a tick."""
        if self._state is None:
            return
        if self._hand_over is not None:
            if self._stack.log is not None:
                self._stack.log.estimated()
            self._hand_over(self._state, self._last_stamp)
            self._publish_inputs(self._last_stamp, again=True)
        self._estimates.publish_odometry(self._state, self._last_stamp)

    def _on_driver_state(self, message: String) -> None:
        """Start over when the simulated robot has been reset."""
        if message.data == topics.HELD and self._state is not None:
            self.activate()


def main(args: list[str] | None = None) -> None:
    """Run the node in a separate process."""
    sys.exit(run([StateEstimatorNode], args))


if __name__ == "__main__":
    main()
