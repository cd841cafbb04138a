"""Records a running robot by polling its topics a hundred times a second, at little cost to the graph."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import JointState

from bridge.record.recording import Recording, sole_middle
from bridge.ros.environment import ignore, newest
from models.errors import PoiseError
from models.nodes import topics
from models.nodes.cdr import NANOSECONDS
from models.nodes.messages import JointStateCodec, WrenchCodec
from models.nodes.odometry import OdometryCodec
from models.nodes.qos import SENSOR
from models.robot_model import SOLE_FRAMES, RobotModel
from models.types import Matrix, Vector


class Observer:
    """Stores the newest sample of each topic at every ``poll``, without an executor; ``recording`` aligns stamps."""

    def __init__(self, model: RobotModel, context: Context | None = None) -> None:
        self._model, self._data = model, model.data()
        self._node = Node("poise_observer", context=context)
        odometry, joints = OdometryCodec(), JointStateCodec(model)
        #: Type and decoder of each topic; the decoded values make one row
        kinds: dict[str, tuple[type, Callable[[bytes], Sequence[Any]]]] = {
            topics.GROUND_TRUTH: (Odometry, odometry.decode),
            topics.ODOM: (Odometry, odometry.decode),
            topics.JOINT_STATES: (JointState, joints.decode),
        }
        self._feet = topics.foot_wrenches(model)
        for topic, frame in zip(self._feet, SOLE_FRAMES, strict=False):
            kinds[topic] = WrenchStamped, WrenchCodec(frame).decode
        self._polled = {
            topic: (self._node.create_subscription(kind, topic, ignore, SENSOR, raw=True), decode)
            for topic, (kind, decode) in kinds.items()
        }
        self._rows: dict[str, list[tuple[int, Vector]]] = {topic: [] for topic in kinds}
        self.stamp = 0.0

    def poll(self) -> None:
        """Read new messages; ``PoiseError`` for a malformed one."""
        for topic, (subscription, decode) in self._polled.items():
            if (data := newest(subscription)) is None:
                continue
            stamp, *values = decode(data)
            rows = self._rows[topic]
            if rows and stamp == rows[-1][0]:
                continue  # published again while simulated time waits
            if rows and stamp < rows[-1][0]:
                rows.clear()  # a new run, for example after a reset
            rows.append((stamp, np.concatenate(values)))
            if topic == topics.GROUND_TRUTH:
                self.stamp = stamp / NANOSECONDS

    @property
    def ready(self) -> bool:
        """Whether every topic has a sample."""
        return all(self._rows.values())

    @property
    def place(self) -> tuple[float, float, float]:
        """Estimated stance: x [m], y [m] and heading [rad] of the midpoint of the soles."""
        q = np.concatenate([self._newest(topics.ODOM)[:7], self._newest(topics.JOINT_STATES)[: self._model.nj]])
        return sole_middle(self._model, self._data, q)

    @property
    def base_position(self) -> Vector:
        """True base position of the newest sample (3,) [m]; NaN before the first."""
        return self._newest(topics.GROUND_TRUTH)[:3] if self._rows[topics.GROUND_TRUTH] else np.full(3, np.nan)

    def _newest(self, topic: str) -> Vector:
        return self._rows[topic][-1][1]

    def recording(self, events: list[tuple[float, str]]) -> Recording:
        """The run at the stamps of the true base; other topics are interpolated. ``PoiseError`` for a silent topic."""
        silent = [topic for topic, rows in self._rows.items() if topic != topics.ODOM and len(rows) < 2]
        if silent:
            raise PoiseError(f"no recording: no messages on {', '.join(silent)}")
        t, base = _table(self._rows[topics.GROUND_TRUTH])

        def at_base(topic: str) -> Matrix:
            """Linear interpolation of each column at the stamps of the base (n, k); constant beyond the ends."""
            stamps, values = _table(self._rows[topic])
            return np.column_stack([np.interp(t, stamps, column) for column in values.T])

        joints = at_base(topics.JOINT_STATES)
        wrenches = np.full((len(t), 2, 6), np.nan)  # NaN without foot sensors
        for foot, topic in enumerate(self._feet):
            wrenches[:, foot] = at_base(topic)
        estimate = at_base(topics.ODOM)[:, :7] if len(self._rows[topics.ODOM]) > 1 else None
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


def _table(rows: list[tuple[int, Vector]]) -> tuple[Vector, Matrix]:
    """Stamps (n,) [s] and values (n, k)."""
    return np.array([stamp for stamp, _ in rows]) / NANOSECONDS, np.array([values for _, values in rows])
