"""Node ``state_estimator``: joints, IMU and feet in; odometry, contacts, orientation and transforms out."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from std_msgs.msg import String

from controllers.estimation.assembler import mean_sample
from controllers.estimation.config import EstimatorConfig
from controllers.estimation.samples import EstimatorHealth
from controllers.nodes.calibration_services import CalibrationServices
from controllers.nodes.estimate_topics import EstimateTopics, declare_rates
from controllers.nodes.sample_topics import SampleTopics, declare_ages
from controllers.stack import ControlStack
from models.config import default_config
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.calibration_file import declare_calibration
from models.nodes.cdr import NANOSECONDS
from models.nodes.parameters import declare, declare_config, declare_lockstep
from models.nodes.qos import EVENT
from models.nodes.spin import program
from models.status import EstimatorStatus
from models.types import RobotState, SensorData, Vector

COASTING_REPORTED = 0.01  #: Time without usable samples after which diagnostics are published at once [s]


class StateEstimatorNode(PoiseNode):
    """Runs ``StateEstimator`` once per complete set of samples.

    ``hand_over`` is called with every state and its stamp [ns] if the controller runs in this process; ``/odom`` is
    then published at ``odom_rate`` only. ``stack`` is shared with that controller; when None, the node creates one with
    the estimator alone.
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
        declare_calibration(self)
        self._lockstep, self._waits = declare_lockstep(self)
        self._rates = declare_rates(self, shared=hand_over is not None, lockstep=self._lockstep)
        self._ages = declare_ages(self)
        text = "Samples averaged at the start, at rest (lockstep: 1)"
        self._start_samples = 1 if self._lockstep else declare(self, "start_samples", 100, text, integer=(1, 10000))
        self._first: list[SensorData] = []
        self._state: RobotState | None = None
        self._last_stamp = 0

    def configure(self) -> None:
        law = self._stack.build_estimator(self.model, self._config)
        self._estimates = EstimateTopics(self, law, self._rates)
        self._samples = SampleTopics(
            self, self._ages, self._step, self._again, lockstep=self._lockstep, waits=self._waits
        )
        self._publish_status = self.announce_status(topics.ESTIMATOR_STATUS)
        self.listen_start(self.activate)
        self._calibration = CalibrationServices(self, self.activate)
        if self._stack.log is not None:
            self._inputs = self.announce(String, topics.APPLIED, EVENT)

    def activate(self) -> None:
        """Start from the next complete sample, with the newest calibration."""
        self._calibration.start()
        self._first.clear()
        self._state = None
        self._samples.reset()
        self._coasting_since: int | None = None

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        self.message = "waiting for a complete sample" if self._state is None else "estimating"
        self._publish_status(EstimatorStatus(self._coasting_since))
        law, assembler, values = self._stack.estimator, self._samples.assembler, self.values
        values["coasting since [ns]"] = "" if self._coasting_since is None else str(self._coasting_since)
        values["samples with mixed stamps"] = str(assembler.incomplete)
        values["ticks without a usable sample"] = str(assembler.dropped)
        values["ticks with a silent sensor"] = str(assembler.silent)
        push = law.push
        values["push [N]"] = _numbers(push.force) if push.active else "none"
        values["impulse of the push [N.s]"] = _numbers(push.impulse)
        for field in fields(law.health):
            value = getattr(law.health, field.name)
            values[field.name.replace("_", " ")] = f"{value:.3f}" if isinstance(value, float) else str(value)

    def _step(self, sensors: SensorData, stamp: int) -> None:
        """Estimate the state of a tick; the estimator starts from the mean of the first samples."""
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
        self._report(stack.estimator.health, stamp)
        self._publish_inputs(stamp)

    def _report(self, health: EstimatorHealth, stamp: int) -> None:
        """Report the start and the end of a drop-out, from the health after the step with a stamp [ns].

        The supervisor receives the stamp of the start, so two messages give the length at any time, independent of the
        rate of the diagnostics.
        """
        if self._coasting_since is None:
            if health.coasting < COASTING_REPORTED:
                return
            self._coasting_since = stamp - round(health.coasting * NANOSECONDS)
            self.counters["drop-outs"] += 1
        elif health.coasting > 0.0:
            return
        else:
            self._coasting_since = None
        self.publish_diagnostics()

    def _publish_inputs(self, stamp: int, *, again: bool = False) -> None:
        """Publish the inputs of a tick after its command is published."""
        log = self._stack.log
        if log is not None and (text := log.take(stamp, again=again)):
            self._inputs.publish(String(data=text))

    def _starts_from(self, sensors: SensorData) -> bool:
        """Add a sample for the start; returns whether there are enough. A silent sensor discards the samples."""
        if not self._samples.assembler.whole:
            self._first.clear()
            return False
        self._first.append(sensors)
        return len(self._first) >= self._start_samples

    def _again(self) -> None:
        """Repeat the outputs of the last tick."""
        if self._state is None:
            return
        if self._hand_over is not None:
            if self._stack.log is not None:
                self._stack.log.estimated()
            self._hand_over(self._state, self._last_stamp)
            self._publish_inputs(self._last_stamp, again=True)
        self._estimates.publish_odometry(self._state, self._last_stamp)


def _numbers(values: Vector) -> str:
    return " ".join(f"{value:.1f}" for value in values)


main = program(StateEstimatorNode)


if __name__ == "__main__":
    main()
