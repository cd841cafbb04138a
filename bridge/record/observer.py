"""Records a running robot from its topics at little cost to the graph: it polls a hundred times a second."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import JointState

from bridge.record.recording import Recording, sole_middle
from bridge.ros.participant import ignore, newest
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import SENSOR
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import Matrix, Vector


class Observer:
    """Stores the newest sample of each topic at every ``poll`` and joins them by their stamps afterwards.

    Its subscriptions have no executor, so samples between two polls cost nothing. ``context`` is a ROS context, the
    default one when None.
    """

    def __init__(self, model: RobotModel, context: Context | None = None) -> None:
        self._model, self._data = model, model.data()
        self._node = Node("poise_observer", context=context)
        subscribe = self._node.create_subscription
        self._odom = subscribe(Odometry, topics.GROUND_TRUTH, ignore, SENSOR, raw=True)
        self._joints = subscribe(JointState, topics.JOINT_STATES, ignore, SENSOR, raw=True)
        self._estimate = subscribe(Odometry, topics.ODOM, ignore, SENSOR, raw=True)
        self._foot_topics = topics.foot_wrenches(model)
        self._feet = [subscribe(WrenchStamped, topic, ignore, SENSOR, raw=True) for topic in self._foot_topics]
        self._odom_codec, self._joint_codec = OdometryCodec(), JointStateCodec(model)
        self._foot_codecs = [WrenchCodec(frame) for frame in SOLE_FRAMES]
        self._base_rows: list[tuple[int, Vector]] = []
        self._joint_rows: list[tuple[int, Vector]] = []
        self._estimate_rows: list[tuple[int, Vector]] = []
        self._foot_rows: tuple[list[tuple[int, Vector]], ...] = ([], [])
        self.stamp = 0.0

    def poll(self) -> None:
        """Read new messages; ``PoiseError`` for a malformed one."""
        data = newest(self._odom)
        if data is not None:
            stamp, pose, twist = self._odom_codec.decode(data)
            _append(self._base_rows, stamp, np.concatenate([pose, twist]))
            self.stamp = stamp / NANOSECONDS
        data = newest(self._estimate)
        if data is not None:
            stamp, pose, _ = self._odom_codec.decode(data)
            _append(self._estimate_rows, stamp, pose)
        data = newest(self._joints)
        if data is not None:
            stamp, *values = self._joint_codec.decode(data)
            _append(self._joint_rows, stamp, np.concatenate(values))
        for foot, subscription in enumerate(self._feet):
            data = newest(subscription)
            if data is not None:
                _append(self._foot_rows[foot], *self._foot_codecs[foot].decode(data))

    @property
    def ready(self) -> bool:
        """Whether every topic has a sample."""
        return all((self._base_rows, self._joint_rows, self._estimate_rows, *self._foot_rows[: len(self._feet)]))

    @property
    def place(self) -> tuple[float, float, float]:
        """Estimated stance: x [m], y [m] and heading [rad] of the middle between the soles."""
        q = np.concatenate([self._estimate_rows[-1][1], self._joint_rows[-1][1][: self._model.nj]])
        return sole_middle(self._model, self._data, q)

    @property
    def base_position(self) -> Vector:
        """True base position of the newest sample (3,) [m]; NaN before the first."""
        return self._base_rows[-1][1][:3] if self._base_rows else np.full(3, np.nan)

    def recording(self, events: list[tuple[float, str]]) -> Recording:
        """The run at the stamps of the true base, others interpolated; ``PoiseError`` when a topic was silent."""
        named = {topics.GROUND_TRUTH: self._base_rows, topics.JOINT_STATES: self._joint_rows}
        named |= dict(zip(self._foot_topics, self._foot_rows, strict=False))
        silent = [name for name, rows in named.items() if len(rows) < 2]
        if silent:
            raise PoiseError(f"nothing to record: {', '.join(silent)} silent")
        t, base = _table(self._base_rows)
        joints = _interpolate(t, *_table(self._joint_rows))
        wrenches = np.full((len(t), 2, 6), np.nan)  # where no foot sensors are fitted
        for foot, rows in enumerate(self._foot_rows[: len(self._feet)]):
            wrenches[:, foot] = _interpolate(t, *_table(rows))
        estimate = _interpolate(t, *_table(self._estimate_rows)) if len(self._estimate_rows) > 1 else None
        nj = self._model.nj
        return Recording(
            robot=self._model.name,
            t=t,
            q=np.hstack([base[:, :7], joints[:, :nj]]),
            v=np.hstack([base[:, 7:], joints[:, nj : 2 * nj]]),
            tau=joints[:, 2 * nj :],
            wrenches=wrenches,
            events=tuple(events),
            estimate=estimate,
        )

    def close(self) -> None:
        """Leave the graph."""
        self._node.destroy_node()


def _append(rows: list[tuple[int, Vector]], stamp: int, values: Vector) -> None:
    """Append a sample; one that is not newer than the last begins a new run, as after a reset."""
    if rows and stamp <= rows[-1][0]:
        rows.clear()
    rows.append((stamp, values))


def _table(rows: list[tuple[int, Vector]]) -> tuple[Vector, Matrix]:
    """Stamps (n,) [s] and values (n, k)."""
    return np.array([stamp for stamp, _ in rows]) / NANOSECONDS, np.array([values for _, values in rows])


def _interpolate(t: Vector, stamps: Vector, values: Matrix) -> Matrix:
    """Linear interpolation of each column at the times ``t``; the ends are held (n, k)."""
    return np.column_stack([np.interp(t, stamps, column) for column in values.T])
