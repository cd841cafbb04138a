"""Node ``terrain_mapper``: elevation map and planar patches of the ground from point clouds and odometry."""

import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import UInt8MultiArray

from models.config import default_config
from models.errors import MessageError
from models.nodes import topics
from models.nodes.base import PoiseNode
from models.nodes.cdr import NANOSECONDS, stamp_of
from models.nodes.grid_map import grid_map_message, grid_map_type, patches_message
from models.nodes.messages import JointStateCodec, stamp_ns, to_seconds
from models.nodes.odometry import OdometryCodec, contacts_from_message
from models.nodes.parameters import declare, declare_config, declare_ns, declare_period
from models.nodes.perception import cloud_from_message
from models.nodes.progress import Progress
from models.nodes.qos import COMMAND, SENSOR, SENSOR_QUEUE, STATE
from models.nodes.services import own_message
from models.nodes.spin import program
from models.range_sensor import DEPTH_FRAME, LIDAR_FRAME, PointCloud
from planners.terrain.config import TerrainMapConfig
from planners.terrain.given_map import load_given_map
from planners.terrain.mapper import Posture, TerrainMapper

HISTORY = 1.0  #: Largest age of a state that is kept for a cloud [s]
_LOST = 1.0  #: Time after the last points with a state within which points without one are only counted [s]


class _History:
    """Buffer of the newest serialised messages of a topic, which are decoded only on use."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, Any]] = deque()

    def add(self, stamp: int, message: Any) -> None:
        """Append a message with a stamp [ns]; a stamp before the newest begins a new run and clears the buffer."""
        if self._kept and stamp < self._kept[-1][0]:
            self._kept.clear()
        self._kept.append((stamp, message))
        while stamp - self._kept[0][0] > HISTORY * NANOSECONDS:
            self._kept.popleft()

    @property
    def newest(self) -> int | None:
        """Stamp of the newest message [ns]; None without one."""
        return self._kept[-1][0] if self._kept else None

    def around(self, stamp: int, tolerance: int) -> tuple[Any, Any, float] | None:
        """Messages before and after a stamp [ns], and its share of the interval between them [-].

        Both are the same message at that stamp and at either end of the buffer. None if either is missing, or farther
        away than ``tolerance`` [ns].
        """
        if not self._kept:
            return None
        place = bisect_right(self._kept, stamp, key=lambda each: each[0])
        (start, first), (end, second) = self._kept[max(place - 1, 0)], self._kept[min(place, len(self._kept) - 1)]
        if start == stamp:
            end, second = start, first
        if max(abs(stamp - start), abs(end - stamp)) > tolerance:
            return None
        return first, second, min(max((stamp - start) / max(end - start, 1), 0.0), 1.0)


class TerrainMapperNode(PoiseNode):
    """Runs ``TerrainMapper`` on each cloud, with odometry, joints and contacts at its stamp."""

    AUTOSTART = True

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("terrain_mapper", **kwargs)
        self._config = declare_config(self, default_config(TerrainMapConfig, "planners", "terrain_map"))
        text = "Largest time between a cloud and the state assigned to it [s]"
        self._tolerance = declare_ns(self, "state_tolerance", 0.02, text, low=0.0)
        text = "Reliable subscription to the clouds; false for a sensor driver that offers best effort only"
        self._reliable = declare(self, "reliable", True, text)
        text = "YAML file of a prior map of the ground, used where the sensors measure nothing; empty: none"
        self._given = declare(self, "given_map", "", text)
        text = "Frame in the headers of the points of the {}, used as that of the profile"
        self._frames = {
            topics.DEPTH_POINTS: (declare(self, "depth_frame", DEPTH_FRAME, text.format("depth camera")), DEPTH_FRAME),
            topics.LIDAR_POINTS: (declare(self, "lidar_frame", LIDAR_FRAME, text.format("lidar")), LIDAR_FRAME),
        }
        self._periods = (
            declare_period(self, "map_rate", 30.0, "terrain/grid_map"),
            declare_period(self, "patch_rate", 2.0, "terrain/patches"),
        )

    def configure(self) -> None:
        given = load_given_map(Path(self._given)) if self._given else None
        self._law = TerrainMapper(self.model, self._config, given)
        self._odometry, self._joints, self._contacts = _History(), _History(), _History()
        self._odometry_codec, self._joints_codec = OdometryCodec(), JointStateCodec(self.model)
        self._coming: tuple[bool, bool] | None = None  # contacts that wait for their odometry
        self._missing, self._outputs = "", list[tuple[Any, Callable[[int], Any]]]()
        try:
            kinds = grid_map_type(), own_message("TerrainPatches")
            self._outputs += [
                (self.announce(kinds[0], topics.TERRAIN_MAP, STATE), self._grid_map),
                (self.announce(kinds[1], topics.TERRAIN_PATCHES, STATE), self._patches),
            ]
        except MessageError as error:
            self._missing = str(error)
        self._progress = Progress(self)
        # queued, since a cloud takes longer than the period of the states
        self.listen(UInt8MultiArray, topics.CONTACTS, self._on_contacts, SENSOR_QUEUE)  # served before their odometry
        self.listen(Odometry, topics.ODOM, self._on_odometry, SENSOR_QUEUE, raw=True)
        self.listen(JointState, topics.JOINT_STATES, self._on_joints, SENSOR_QUEUE, raw=True)
        self.listen_start(self._law.reset)  # placed upright on other ground
        sensors, qos = self.model.profile.sensors, COMMAND if self._reliable else SENSOR
        for topic, sensor in ((topics.DEPTH_POINTS, sensors.depth), (topics.LIDAR_POINTS, sensors.lidar)):
            if sensor is not None:
                self.listen(PointCloud2, topic, partial(self._on_cloud, topic), qos, while_active=True)

    def activate(self) -> None:
        self._law.reset()
        self._due = [0, 0]  # stamps of the next map and patches [ns]
        self._took, self._clouds, self._stateless = 0.0, 0, 0
        self._matched: dict[str, float] = {}  # monotonic time of the last points with a state, by topic [s]

    def deactivate(self) -> None:
        self._progress.report_idle()

    def _on_joints(self, data: bytes) -> None:
        stamp = stamp_of(data)
        self._joints.add(stamp, data)
        self._progress.report(stamp)

    def _on_odometry(self, data: bytes) -> None:
        stamp = stamp_of(data)
        if self.active and stamp < (self._odometry.newest or 0):
            self.activate()  # a new run
        self._odometry.add(stamp, data)
        if self._coming is not None:
            self._contacts.add(stamp, self._coming)
            self._coming = None
        if self.active and to_seconds(stamp) - self._law.t >= self._config.feet.period:
            around = self._around(stamp)
            if None not in around.values() and (posture := self._posture(around)) is not None:
                self._law.follow(to_seconds(stamp), posture)
                if self._given:
                    self._publish(stamp)

    def _on_contacts(self, message: Any) -> None:
        self._coming = contacts_from_message(message)  # without a stamp; published before the odometry of their tick

    def _on_cloud(self, topic: str, message: Any) -> None:
        stamp = stamp_ns(message.header.stamp)
        around = self._around(stamp)
        if absent := [topic for topic, found in around.items() if found is None]:
            self._stateless += 1
            if time.monotonic() - self._matched.setdefault(topic, time.monotonic()) < _LOST:
                return  # under load one of the three is sometimes late
            raise MessageError(f"no {', '.join(absent)} within {self._tolerance / 1e9:g} s of the points")
        posture = self._posture(around)
        if posture is None:
            return
        begin = time.monotonic()
        (named, frame), sent = self._frames[topic], message.header.frame_id
        if sent != named:
            parameter = f"parameter {topic.partition('/')[0]}_frame"
            raise MessageError(f"header.frame_id: '{sent[:32]}' instead of '{named}', {parameter}")
        cloud = cloud_from_message(message)
        self._law.update(PointCloud(cloud.t, frame, cloud.points), posture)
        self._matched[topic] = time.monotonic()
        self._took, self._clouds = self._matched[topic] - begin, self._clouds + 1
        self._publish(stamp)

    def _around(self, stamp: int) -> dict[str, Any]:
        """``_History.around`` a stamp [ns], by topic."""
        histories = {topics.ODOM: self._odometry, topics.JOINT_STATES: self._joints, topics.CONTACTS: self._contacts}
        return {topic: each.around(stamp, self._tolerance) for topic, each in histories.items()}

    def _posture(self, around: dict[str, Any]) -> Posture | None:
        """Posture interpolated between the messages ``around`` a stamp; None if one is malformed and refused."""
        odometry, joints, contacts = around.values()
        poses = [self._decoded(topics.ODOM, self._odometry_codec, data) for data in odometry[:2]]
        angles = [self._decoded(topics.JOINT_STATES, self._joints_codec, data) for data in joints[:2]]
        if any(each is None for each in (*poses, *angles)):
            return None
        pose = pin.SE3ToXYZQUAT(pin.SE3.Interpolate(*map(pin.XYZQUATToSE3, poses), odometry[2]))
        q = angles[0] + joints[2] * (angles[1] - angles[0])
        return Posture(np.concatenate([pose, q]), contacts[0] if contacts[2] < 0.5 else contacts[1])

    def _decoded(self, topic: str, codec: OdometryCodec | JointStateCodec, data: bytes) -> Any:
        """Pose or joint angles of a message; None if it is malformed and refused."""
        try:
            return codec.decode(data)[1]
        except MessageError as error:
            self.refuse(topic, error)
            return None

    def _publish(self, stamp: int) -> None:
        """Publish outputs that are due at a stamp [ns] and have a subscriber; they may be up to half a period early."""
        for i, (publisher, message) in enumerate(self._outputs):
            late, half = stamp - self._due[i], self._periods[i] // 2
            if late >= -half and not np.isnan(self._law.reference):
                self._due[i] = self._periods[i] + (stamp if late > half else self._due[i])
                if publisher.get_subscription_count():
                    publisher.publish(message(stamp))

    def _grid_map(self, stamp: int) -> Any:
        grid = self._law.map
        layers = {
            "elevation": grid.height + self._law.reference,
            "variance": grid.variance,
            "age": to_seconds(stamp) - grid.seen,
        }
        known = {name: np.where(grid.known, layer, np.nan) for name, layer in layers.items()}
        return grid_map_message(stamp, grid.centre, grid.cell, known, "elevation")

    def _patches(self, stamp: int) -> Any:
        raised = np.array([0.0, 0.0, self._law.reference])
        return patches_message(stamp, [(patch.normal, patch.vertices + raised) for patch in self._law.patches()])

    def before_diagnostics(self) -> None:
        if not self.active:
            return
        law = self._law
        self.level = DiagnosticStatus.WARN if self._missing else DiagnosticStatus.OK
        self.message = self._missing or ("mapping" if self._clouds else "given map" if self._given else "no cloud yet")
        if self._given and not law.covered and not np.isnan(law.reference):
            self.level = DiagnosticStatus.WARN
            self.message = "the given map does not contain the ground below the robot: check its origin"
        self.values |= {
            "clouds": str(self._clouds),
            "points without a state": str(self._stateless),
            "newest cloud took [ms]": f"{1e3 * self._took:.1f}",
            "known cells": f"{law.map.known.mean():.2f}",
            "sole above the map [mm]": f"{1e3 * law.residual:.1f}",
        }


main = program(TerrainMapperNode)


if __name__ == "__main__":
    main()
