"""Whether the legs keep off each other, which the plant does not see to: its bodies pass through one another."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from models.config import default_config
from models.robot_model import RobotModel
from models.types import Vector
from planners.collision import SelfCollision
from planners.motion_config import MotionConfig


class LegClearance:
    """Least distance between the left and the right leg.

    Legs are the convex hulls of the URDF's collision bodies, and a box on each contact rectangle: some URDFs have only
    four points for a foot.

    Args:
        robot: The robot.
        thickness: Height of the boxes [m].
    """

    def __init__(self, robot: RobotModel, thickness: float) -> None:
        self._robot = robot
        self._hulls = SelfCollision(robot, default_config(MotionConfig, "planners", "motion").collision)
        legs = [
            set(robot.pin.supports[robot.pin.frames[foot.frame_id].parentJoint].tolist()[2:]) for foot in robot.feet
        ]
        joints = [body.parentJoint for body in self._hulls.geometry.geometryObjects]
        between = []
        for k in range(self._hulls.count):
            first, second = (joints[i] for i in self._hulls.bodies(k))
            between.append((first in legs[0] and second in legs[1]) or (first in legs[1] and second in legs[0]))
        self._between = np.array(between)
        self._data = robot.data()
        self._boxes, self._places = [], []
        for foot in robot.feet:
            back, front, right, left = foot.rectangle
            self._boxes.append(coal.Box(front - back, left - right, thickness))
            middle = np.array([0.5 * (back + front), 0.5 * (left + right), 0.5 * thickness])
            self._places.append(pin.SE3(np.eye(3), middle))

    def distance(self, q: Vector) -> float:
        """Least distance, negative when the legs overlap [m]; infinite when they are surely apart.

        Args:
            q: Configuration (nq,) [m, rad].
        """
        hulls = self._hulls.distances(q, 0.0)[self._between]
        pin.framesForwardKinematics(self._robot.pin, self._data, q)
        poses = [
            self._data.oMf[foot.frame_id] * place for foot, place in zip(self._robot.feet, self._places, strict=True)
        ]
        transforms = [coal.Transform3s(pose.rotation, pose.translation) for pose in poses]
        result = coal.DistanceResult()
        soles = coal.distance(
            self._boxes[0], transforms[0], self._boxes[1], transforms[1], coal.DistanceRequest(), result
        )
        return min(float(soles), float(hulls.min(initial=np.inf)))
