"""Ankles at their limits: the edge that a sole then turns over."""

from typing import NamedTuple

import pinocchio as pin

from models.constants import JOINTS_Q, JOINTS_V
from models.robot_model import Foot, RobotModel
from models.types import Matrix, RobotState, Vector
from planners.gait.config import AnkleConfig, leg_length

_HEIGHT = 0.25  #: Joints lower than this share of the leg above the sole are the ankle's [-]
_ALIGNED = 0.7  #: Least cosine between the axis of such a joint and that of the sole that it turns about [-]


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
        data = model.data()
        pin.computeJointJacobians(model.pin, data, model.standing_configuration())
        height = _HEIGHT * leg_length(model)
        self._ankles = [_ankle_joints(model, data, foot, height) for foot in model.feet]

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


def _ankle_joints(model: RobotModel, data: pin.Data, foot: Foot, height: float) -> list[_AnkleJoint]:
    """The joints of a foot's ankle; ``data`` has the joint Jacobians of the 'stand' posture."""
    sole, found = pin.updateFramePlacement(model.pin, data, foot.frame_id), []
    axes = pin.getFrameJacobian(model.pin, data, foot.frame_id, pin.LOCAL)[3:]  # of the joints, in the sole frame
    for column in foot.joint_ids_v:
        joint = next(j for j in range(model.pin.njoints) if model.pin.idx_vs[j] == column)
        if data.oMi[joint].translation[2] - sole.translation[2] > height:
            continue
        roll, pitch = axes[0, column], axes[1, column]
        # At the upper limit of a positive roll the shank leans to the left of the sole, at that of a pitch to its rear.
        if abs(roll) > _ALIGNED:
            found.append(_AnkleJoint(column - JOINTS_V, *((2, 3) if roll > 0.0 else (3, 2))))
        elif abs(pitch) > _ALIGNED:
            found.append(_AnkleJoint(column - JOINTS_V, *((1, 0) if pitch > 0.0 else (0, 1))))
    return found
