"""Ankles at their limits: the edge that a sole then turns over."""

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
    at_upper: int  # ... and at the upper one


class AnkleStops:
    """Determines the edge that a stance sole turns over because an ankle joint is at its limit.

    The shank of a stance leg leans with the body. From the limit of the ankle on it takes the sole along, which turns
    over the edge on the side of the lean. A sole that is held flat instead makes the QP turn the base about the hip.
    """

    def __init__(self, model: RobotModel, config: AnkleConfig) -> None:
        self._time, self._rim = config.stop_time, config.rim
        self._rectangles = [foot.rectangle for foot in model.feet]
        self._lower, self._upper = model.q_lower + config.stop_margin, model.q_upper - config.stop_margin
        # At the upper limit of a positive roll the shank leans to the left of the sole, at that of a pitch to its rear.
        edges = {(LENGTH, True): (2, 3), (LENGTH, False): (3, 2), (WIDTH, True): (1, 0), (WIDTH, False): (0, 1)}
        self._ankles = [
            [_AnkleJoint(each.index_v - JOINTS_V, *edges[each.axis, each.positive]) for each in foot.ankle]
            for foot in model.feet
        ]

    def on_edge(self, foot: int, state: RobotState, cop: Vector, areas: Matrix) -> Matrix:
        """Areas of the soles (2, 4) [m], without width where an ankle joint of ``foot`` comes to its limit in time.

        ``cop`` is its centre of pressure (2,) [m], in its frame: a sole turns over an edge only if that is at the edge.
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
