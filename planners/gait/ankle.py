"""Edges that a sole turns over when its ankle is at a joint limit."""

from typing import NamedTuple

from models.constants import JOINTS_Q, JOINTS_V
from models.foot import LENGTH, WIDTH
from models.robot_model import RobotModel
from models.types import Matrix, RobotState, Vector
from planners.gait.config import AnkleConfig


class _AnkleJoint(NamedTuple):
    """A joint that turns a sole over two opposite edges."""

    joint: int  # among all joints
    at_lower: int  # index into x_min, x_max, y_min, y_max of the edge that the sole turns over at the lower limit
    at_upper: int  # the same at the upper limit


class AnkleStops:
    """Determines the edge that a stance sole turns over when an ankle joint is at its limit.

    The shank of the stance leg leans with the body. Once the ankle is at its limit, the sole turns with the shank over
    the edge on the side of the lean. With a sole held flat, the QP would turn the base about the hip instead.
    """

    def __init__(self, model: RobotModel, config: AnkleConfig) -> None:
        self._time, self._rim = config.stop_time, config.rim
        self._rectangles = [foot.rectangle for foot in model.feet]
        self._lower, self._upper = model.q_lower + config.stop_margin, model.q_upper - config.stop_margin
        # At the upper limit of a positive roll the shank leans to the left of the sole; of a positive pitch, rearward.
        edges = {(LENGTH, True): (2, 3), (LENGTH, False): (3, 2), (WIDTH, True): (1, 0), (WIDTH, False): (0, 1)}
        self._ankles = [
            [_AnkleJoint(each.index_v - JOINTS_V, *edges[each.axis, each.positive]) for each in foot.ankle]
            for foot in model.feet
        ]

    def on_edge(self, foot: int, state: RobotState, cop: Vector, areas: Matrix) -> Matrix:
        """Areas of the soles (2, 4) [m], reduced to an edge if an ankle of ``foot`` reaches its limit in ``stop_time``.

        ``cop`` is the CoP of the sole in its frame (2,) [m]; a sole turns over an edge only if its CoP is at the edge.
        """
        q, v, out, rectangle = state.q[JOINTS_Q:], state.v[JOINTS_V:], areas, self._rectangles[foot]
        for joint, at_lower, at_upper in self._ankles[foot]:
            ahead = float(q[joint] + self._time * v[joint])
            if self._lower[joint] < ahead < self._upper[joint]:
                continue
            edge = at_upper if ahead >= self._upper[joint] else at_lower
            if abs(cop[edge // 2] - rectangle[edge]) <= self._rim:
                out = out.copy()
                out[foot, 2 * (edge // 2) : 2 * (edge // 2) + 2] = rectangle[edge]
        return out
