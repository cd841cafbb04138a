"""Node ``range_sensor_node``: depth camera and lidar of the simulated robot, in a separate process from the plant."""

import os
import sys
import time
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

from bridge.nodes.camera_node import NICENESS
from bridge.nodes.true_states import TrueStates
from bridge.plants.range_sensors import RayWorld, Schedule, SimulatedDepthCamera, SimulatedLidar
from models.errors import ConfigError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.messages import to_seconds
from models.nodes.parameters import declare
from models.nodes.perception import cloud_message, depth_message, info_message
from models.nodes.progress import IDLE, Progress
from models.nodes.qos import STATE
from models.nodes.spin import run
from models.range_sensor import DEPTH_FRAME, DEPTH_UNIT, RangeSensor
from models.terrain import FLAT, terrain_named
from models.types import Vector


class _Output(Schedule[dict[str, Any]]):
    """Publishers of one sensor by topic, and the schedule of their messages."""

    def __init__(self, publishers: dict[str, Any], sensor: RangeSensor, phase: float) -> None:
        self._publishers = publishers
        super().__init__(sensor, phase)

    @property
    def used(self) -> bool:
        """Whether one of the topics has a subscriber."""
        return any(publisher.get_subscription_count() for publisher in self._publishers.values())

    def publish(self, stamp: int) -> None:
        """Publish the messages that have arrived by a stamp [ns]."""
        for messages in self.arrived(stamp):
            for topic, message in messages.items():
                self._publishers[topic].publish(message)


class RangeSensorNode(PoiseNode):
    """Publishes depth images and point clouds of the newest true state while there are subscribers."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("range_sensor_node", **kwargs)
        text = "Ground of the simulated world, as in the driver: flat, tiles, box, ..."
        self._terrain = declare(self, "terrain", FLAT, text)
        self._seed = declare(self, "seed", 0, "Seed of the sensors' errors", integer=(0, 2**63 - 1))
        self._noise = declare(self, "noise", 1.0, "Factor on the errors of the profile", low=0.0, high=100.0)
        self._took: dict[str, float] = {}

    def configure(self) -> None:
        sensors = self.model.profile.sensors
        if sensors.depth is None and sensors.lidar is None:
            raise ConfigError(f"{self.robot}: sensors.depth, sensors.lidar: the profile has neither")
        terrain_named(self._terrain)
        self._outputs: dict[str, _Output] = {}
        if sensors.depth is not None:
            kinds = {topics.DEPTH_IMAGE: Image, topics.DEPTH_INFO: CameraInfo, topics.DEPTH_POINTS: PointCloud2}
            publishers = {topic: self.announce(kind, topic, STATE) for topic, kind in kinds.items()}
            self._outputs["depth"] = _Output(publishers, sensors.depth, 0.0)
        if sensors.lidar is not None:
            publishers = {topics.LIDAR_POINTS: self.announce(PointCloud2, topics.LIDAR_POINTS, STATE)}
            self._outputs["lidar"] = _Output(publishers, sensors.lidar, 0.5)
        self._progress = Progress(self)
        self._casts = {"depth": self._cast_depth, "lidar": self._cast_lidar}
        TrueStates(self, self._is_due, self._measure, self._on_obstacle, self._on_stamp)

    def activate(self) -> None:
        sensors = self.model.profile.sensors
        self._world = RayWorld(self.model, self._terrain)
        if sensors.depth is not None:
            self._depth = SimulatedDepthCamera(self._world, self._seed, self._noise)
        if sensors.lidar is not None:
            self._lidar = SimulatedLidar(self._world, self._seed, self._noise)
        self._measured: list[str] = []  # sensors that are due now
        self._restart()

    def deactivate(self) -> None:
        self._progress.report_idle()

    def _restart(self) -> None:
        self._stamp = 0  # stamp of the newest state [ns]
        for output in self._outputs.values():
            output.restart()

    def _on_stamp(self, stamp: int) -> None:
        """Publish messages whose latency has passed; a stamp that goes back begins a new run and drops all messages."""
        if stamp < self._stamp:
            self._restart()
        self._stamp = stamp
        for output in self._outputs.values():
            output.publish(stamp)

    def _on_obstacle(self, centre: Vector) -> None:
        if self.active:
            self._world.obstacle = centre

    def _is_due(self, stamp: int) -> bool:
        """Find the sensors that are due now."""
        used = {name: output for name, output in self._outputs.items() if output.used}
        self._measured = [name for name, output in used.items() if output.due(stamp)]
        if not self._measured:
            self._progress.report(stamp if used else IDLE)
        return bool(self._measured)

    def _measure(self, stamp: int, q: Vector) -> None:
        self._world.set(q)
        for name in self._measured:
            begin = time.monotonic()
            self._outputs[name].hold(stamp, self._casts[name](stamp))
            self._took[name] = time.monotonic() - begin
        self._progress.report(stamp)

    def _cast_depth(self, stamp: int) -> dict[str, Any]:
        camera = self._depth
        picture = np.round(camera.picture() / DEPTH_UNIT) * DEPTH_UNIT
        picture[~(picture > 0.0)] = np.nan
        cloud = camera.points(to_seconds(stamp), picture)  # points of the picture as published
        return {
            topics.DEPTH_INFO: info_message(stamp, camera.intrinsics, DEPTH_FRAME),
            topics.DEPTH_IMAGE: depth_message(stamp, picture),
            topics.DEPTH_POINTS: cloud_message(stamp, cloud),
        }

    def _cast_lidar(self, stamp: int) -> dict[str, Any]:
        return {topics.LIDAR_POINTS: cloud_message(stamp, self._lidar.cloud(to_seconds(stamp)))}

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        self.message = "measuring" if any(each.used for each in self._outputs.values()) else "no subscriber"
        self.values |= {f"newest {name} took [ms]": f"{1e3 * took:.1f}" for name, took in self._took.items()}


def main(args: list[str] | None = None) -> None:
    """Run the node in a separate process, with a lower priority than those of the robot."""
    os.nice(NICENESS)
    sys.exit(run([RangeSensorNode], args))


if __name__ == "__main__":
    main()
