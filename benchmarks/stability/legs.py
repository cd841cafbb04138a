"""Contact between the legs, from the shapes of their links; the same check for every controller."""

import pinocchio as pin

from models.leg_shapes import leg_shapes
from models.robot_model import RobotModel
from models.types import Vector


class LegContact:
    """Detects intersection of the left and the right leg; see ``leg_shapes``."""

    def __init__(self, robot: RobotModel) -> None:
        self._model, self._data, self._geometry = robot.pin, robot.data(), leg_shapes(robot)
        self._contacts = self._geometry.createData()

    def find(self, q: Vector) -> str:
        """Return the first two links in contact at a configuration (nq,); empty if there are none."""
        if not pin.computeCollisions(self._model, self._data, self._geometry, self._contacts, q, True):
            return ""
        results = zip(self._geometry.collisionPairs, self._contacts.collisionResults, strict=True)
        pair = next(pair for pair, result in results if result.isCollision())
        names = [self._geometry.geometryObjects[i].parentFrame for i in (pair.first, pair.second)]
        return " and ".join(self._model.frames[name].name for name in names)
