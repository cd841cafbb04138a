"""Node ``imu_node``: raw IMU samples in; orientation and unbiased rate out, optionally into a table."""

from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import Imu

from controllers.estimation.orientation_filter import OrientationFilter, OrientationFilterConfig
from controllers.estimation.stamps import Due, StampFilter
from models.config import default_config
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS
from models.nodes.imu import CsvImuLog, ImuSample, OrientedImuCodec
from models.nodes.messages import ImuCodec
from models.nodes.parameters import declare, declare_config, declare_ns, declare_period
from models.nodes.qos import SENSOR, STATE
from models.nodes.spin import program
from models.types import Vector

NO_COVARIANCE = np.zeros((3, 3))  #: The filter has no covariance: zeros mean unknown (sensor_msgs/Imu)


class ImuNode(PoiseNode):
    """Runs ``OrientationFilter`` on each sample of ``imu/data_raw``; orientation from the IMU alone.

    The state estimator publishes ``imu/data``, so this node publishes ``imu/data_filtered``. Without an estimator,
    remap it.
    """

    AUTOSTART = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("imu_node", **kwargs)
        config = default_config(OrientationFilterConfig, "controllers", "orientation_filter")
        self._config = declare_config(self, config, "filter.")
        self._period = declare_period(self, "rate", 100.0, f"{topics.IMU_FILTERED} and of the table")
        text = "Samples averaged at the start, at rest"
        self._start_samples = declare(self, "start_samples", 100, text, integer=(1, 10000))
        text = "Largest step of a stamp that is accepted at once [s]"
        self._gap_max = declare_ns(self, "gap_max", 0.05, text, low=0.001, high=1.0)
        text = "Table to write: orientation, rate without bias, specific force (CSV); empty for none"
        self._path = declare(self, "log.csv", "", text)
        self._log: CsvImuLog | None = None
        self._rows = 0
        self._first: list[tuple[Vector, Vector]] = []
        self._started = False

    def configure(self) -> None:
        self._law = OrientationFilter(self._config)
        self._raw, self._codec = ImuCodec(topics.IMU_FRAME), OrientedImuCodec(topics.IMU_FRAME)
        self._filtered = self.announce(Imu, topics.IMU_FILTERED, STATE)
        self.listen(Imu, topics.IMU_RAW, self._on_imu, SENSOR, raw=True, while_active=True)
        self.listen_start(self._start_over)

    def activate(self) -> None:
        """Start from the next samples at rest, with a new table."""
        self._start_over()
        if self._path:
            self._log, self._rows = CsvImuLog(Path(self._path)), 0

    def deactivate(self) -> None:
        """Complete the table; a table without a sample is discarded."""
        log, self._log = self._log, None
        if log is not None:
            log.close(keep=self._rows > 0)

    def _start_over(self) -> None:
        self._first.clear()
        self._started = False
        self._due, self._stamps = Due(self._period), StampFilter(self._gap_max)

    def _on_imu(self, data: bytes) -> None:
        stamp, gyro, accel = self._raw.decode(data)
        if stamp == self._stamps.last:
            return  # a plant that waits repeats its samples
        step = self._stamps.step(stamp)
        if not self._started:
            self._average(gyro, accel)
            return
        if step > self._gap_max:
            self.counters["gaps bridged"] += 1
        self._law.step(gyro, accel, step / NANOSECONDS)
        if self._due(stamp):
            sample = ImuSample(self._law.quaternion, NO_COVARIANCE, gyro - self._law.bias, accel)
            data = self._codec.encode(stamp, sample)
            self._filtered.publish(data)
            if self._log is not None:
                self._log.add(stamp, sample, data)
                self._rows += 1

    def _average(self, gyro: Vector, accel: Vector) -> None:
        self._first.append((gyro, accel))
        if len(self._first) < self._start_samples:
            return
        mean = np.mean(self._first, axis=0)
        self._first.clear()
        self._law.reset(mean[0], mean[1])
        self._started = True

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        self.message = "filtering" if self._started else "waiting for a robot at rest"
        if self._started:
            self.values["gyro bias [rad/s]"] = " ".join(f"{value:.4f}" for value in self._law.bias)
            self.values["at rest"] = str(self._law.resting)


main = program(ImuNode)


if __name__ == "__main__":
    main()
