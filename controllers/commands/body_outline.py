"""Reach of a standing robot to every side."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from models.robot_model import RobotModel
from models.types import Matrix, Vector


class BodyOutline:
    """The hulls of the profile and the soles in the 'stand' posture, seen from above in B."""

    def __init__(self, model: RobotModel) -> None:
        self._data = model.data()
        pin.framesForwardKinematics(model.pin, self._data, model.standing_configuration())
        self._base = self._data.oMf[model.frame_id("base_link")]
        points = [(foot.frame_id, corner, 0.0) for foot in model.feet for corner in foot.corners]
        for name, hull in model.profile.hulls.items():
            frame = model.link_frame_id(hull.link, f"hull '{name}'")
            points += [(frame, np.array(end), hull.radius) for end in (hull.start, hull.end)]
        self._centres: Matrix = np.array([self.placement(frame).act(point)[:2] for frame, point, _ in points])
        self._radii: Vector = np.array([radius for _, _, radius in points])

    def placement(self, frame: int) -> pin.SE3:
        """Placement in B of a frame of Pinocchio, in this posture."""
        return self._base.actInv(self._data.oMf[frame])

    def reach(self, direction: Vector) -> float:
        """Reach of the body from B's origin in a direction, a unit vector in B (2,) [m]."""
        return float((self._centres @ direction + self._radii).max())
